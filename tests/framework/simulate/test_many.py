"""A batch equals its single runs, in their order, for any outcome of each run."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.parameter import Diagonal, Gain, Positive, PositiveDefinite, Real, Scalar
from dmframe.block.port import Output, Side, State
from dmframe.common.errors import DmframeError, UnknownNameError, ValueFault
from dmframe.diagram import Diagram
from dmframe.diagram.values import with_values
from dmframe.graph.graph import Graph
from dmframe.results.metrics import tracking_error
from dmframe.simulate import Recording, simulate, simulate_many

VARIANTS: list[dict[str, Any]] = [
    {},
    {"dynamics.Gamma": 30.0},
    {"servo.K_P": [50.0, 20.0], "arm.viscous": [2.0, 1.0]},
    {"start": {"q": [0.8, 1.1]}},
    {"inverse.w_I": 3.0, "path.amplitude": ["10 deg", "15 deg"]},
]


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_a_batch_gives_what_single_runs_of_changed_graphs_give(engine: Any) -> None:
    overrides = [
        [],
        ["dynamics.Gamma=30"],
        ["servo.K_P=[50, 20]", "arm.viscous=[2, 1]"],
        ["start={q: [0.8, 1.1]}"],
        ["inverse.w_I=3", "path.amplitude=[10 deg, 15 deg]"],
    ]
    graph = Graph.read("arm2_joint")
    batch = simulate_many(graph.diagram, VARIANTS, 0.5, clock=graph.file.clock, start=graph.start, engine=engine)
    for run, changes in zip(batch, overrides, strict=True):
        other = Graph.read("arm2_joint", changes)
        single = simulate(other.diagram, 0.5, clock=other.file.clock, start=other.start, engine=engine)
        assert isinstance(run, Recording)
        assert run.engine == engine
        for label, values in {**single.states, **single.outputs}.items():
            np.testing.assert_array_equal(run[label], values)


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_a_run_of_a_batch_takes_the_steps_that_it_would_take_alone(engine: Any) -> None:
    diagram = Graph.read("arm2_joint").diagram
    variants = [{}, {"arm.viscous": [1.0, 800.0]}, {"arm.viscous": [1.0, 1e7]}]
    batch = simulate_many(diagram, variants, 0.1, clock=0.002, engine=engine)
    for run, values in zip(batch, variants, strict=True):
        single = simulate(with_values(diagram, values), 0.1, clock=0.002, engine=engine)
        assert isinstance(run, Recording)
        assert (run.solver, run.notices, run.divergence) == (single.solver, single.notices, single.divergence)
        np.testing.assert_array_equal(run["arm.q"], single["arm.q"])
    first, second, third = batch
    assert second.solver.step < first.solver.step  # type: ignore[union-attr]
    assert third.solver.method == "ros34pw2"  # type: ignore[union-attr]


def test_order_and_numbers_do_not_depend_on_the_number_of_threads() -> None:
    graph = Graph.read("arm2_joint")
    diagram = graph.diagram
    variants = [{"dynamics.Gamma": float(gamma)} for gamma in range(1, 13)]

    def last(run: Recording) -> float:
        error = tracking_error(run)
        assert error is not None
        assert error.rms_final is not None
        return error.rms_final

    given: dict[str, Any] = {"clock": graph.file.clock, "engine": "compiled", "reduce": last}
    one, four = (simulate_many(diagram, variants, 1.0, threads=threads, **given) for threads in (1, 4))
    assert one == four
    assert len(set(one)) == len(variants)


def test_one_that_diverges_and_one_that_cannot_start_leave_the_others_alone() -> None:
    graph = Graph.read("arm2_joint", ["inverse.w_box=null"])
    variants = [{}, {"dynamics.Gamma": 1e9}, {"dynamics.Gamma": -1.0}, {"start": {"qq": 1.0}}, {}]
    first, wild, wrong, lost, last = simulate_many(
        graph.diagram, variants, 20.0, clock=graph.file.clock, start=graph.start, engine="compiled"
    )
    assert isinstance(first, Recording)
    assert isinstance(last, Recording)
    assert isinstance(wild, Recording)
    assert first.divergence is None
    assert wild.divergence is not None
    np.testing.assert_array_equal(first["arm.q"], last["arm.q"])
    assert isinstance(wrong, ValueFault)
    assert isinstance(lost, UnknownNameError)


def test_a_batch_compiles_once(cache: Path) -> None:
    graph = Graph.read("arm2_joint")
    simulate_many(graph.diagram, VARIANTS, 0.1, clock=graph.file.clock, start=graph.start, engine="compiled")
    assert len(list(cache.glob("*.so"))) == 1


def test_other_numbers_do_not_change_the_diagram() -> None:
    diagram = Graph.read("arm2_joint").diagram
    before = diagram.loop.p_values.copy()
    changed = with_values(diagram, {"dynamics.Gamma": 7.0})
    np.testing.assert_array_equal(diagram.loop.p_values, before)
    assert np.any(changed.loop.p_values != before)
    assert changed.loop.controller is diagram.loop.controller


@pytest.mark.parametrize(
    ("values", "text"),
    [
        (
            {"dynamics.Gama": 1.0},
            "values.dynamics.Gama: unknown parameter that is a number; did you mean dynamics.Gamma?",
        ),
        ({"model.friction": ["coulomb"]}, "values.model.friction: unknown parameter that is a number"),
        ({"inverse.w_box": None}, "values.inverse.w_box: expected a number, found none; removing it requires another"),
        ({"servo.K_P": [1.0, 2.0, 3.0]}, "servo.K_P: "),
        ({"servo.K_P": "5 kg"}, "K_P"),
    ],
)
def test_numbers_that_are_not_allowed_are_errors(values: dict[str, Any], text: str) -> None:
    with pytest.raises(DmframeError) as fault:
        with_values(Graph.read("arm2_joint").diagram, values)
    assert text in str(fault.value)


def test_no_threads_are_too_few() -> None:
    with pytest.raises(ValueFault, match="threads: expected at least 1, found 0"):
        simulate_many(Graph.read("arm2_joint").diagram, [{}], 0.1, threads=0)


class Plain(AbstractBlock):
    """dx = -k x from x = c, with k or c read as a number if `numeric` names it."""

    side = Side.PLANT
    outputs = (Output("x", "n"),)
    states = (State("x", "n"),)
    k: Scalar = Real(default=1.0)
    c: Scalar = Real(default=1.0)
    honest: Scalar = Real(default=1.0)
    size: Diagonal = Real("n", default=(1.0, 1.0))
    numeric: str = ""

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        k = self.k if self.numeric == "k" else p.k
        return Equations(outputs={"x": x.x}, rates={"x": -k * p.honest * x.x})

    def start(self, u: Signals, p: Signals, truth: Signals) -> dict[str, Any]:
        return {"x": (self.c if self.numeric == "c" else p.c) * p.size}


@pytest.mark.parametrize("name", ["k", "c"])
def test_a_number_that_a_block_reads_as_such_is_refused_and_a_symbol_serves_all_values(name: str) -> None:
    with pytest.raises(DmframeError, match=f"plant: its methods read the number {name} from self"):
        simulate(Diagram.build({"plant": Plain(numeric=name)}), 0.1)
    diagram = Diagram.build({"plant": Plain()})
    honest = with_values(diagram, {"plant.honest": 5.0, f"plant.{name}": 3.0})
    alone = Diagram.build({"plant": Plain(honest=5.0, **{name: 3.0})})
    np.testing.assert_array_equal(simulate(honest, 0.1)["plant.x"], simulate(alone, 0.1)["plant.x"])


def test_a_leak_pulls_back_to_the_start_that_the_variant_has() -> None:
    leaking = Graph.read("joint_tracking_pi", ["inverse.leak=0.5"])
    (run,) = simulate_many(leaking.diagram, [{"inverse.w": 0.003}], 5.0, clock=leaking.file.clock)
    other = Graph.read("joint_tracking_pi", ["inverse.leak=0.5", "inverse.w=0.003"])
    single = simulate(other.diagram, 5.0, clock=other.file.clock)
    np.testing.assert_array_equal(run["inverse.w"], single["inverse.w"])  # type: ignore[index, unused-ignore]


def test_a_gain_that_follows_from_another_block_follows_it() -> None:
    class Model(AbstractBlock):
        """Declares the size of its errors."""

        side = Side.PLANT
        outputs = (Output("y", "n"),)
        spread: Scalar = Positive(default=1.0)

        def prior(self, robot: Any, others: Fraction) -> list[list[Fraction]]:
            s = Fraction(self.spread)
            return [[s, Fraction(0)], [Fraction(0), s]]

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"y": p.spread * ca.SX.ones(2)})

    class Learner(AbstractBlock):
        """dw = Gamma (1 - w)."""

        side = Side.PLANT
        outputs = (Output("w", "n"),)
        states = (State("w", "n"),)
        Gamma: Gain = PositiveDefinite("n")
        size: Diagonal = Real("n", default=(1.0, 1.0))

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"w": x.w}, rates={"w": p.Gamma @ (p.size - x.w)})

    def built(spread: float) -> Diagram:
        return Diagram.build({"model": Model(spread=spread), "law": Learner(Gamma={"inverse_of": "model"})})

    changed = with_values(built(1.0), {"model.spread": 10.0})
    np.testing.assert_array_equal(simulate(changed, 1.0)["law.w"], simulate(built(10.0), 1.0)["law.w"])
