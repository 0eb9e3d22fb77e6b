"""Inputs that are a source's signal some samples later: against the source's own formula."""

from __future__ import annotations

from typing import Any, ClassVar

import casadi as ca
import numpy as np
import pytest

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.parameter import Positive, Real, Scalar
from dmframe.block.port import PERIOD, TIME, Access, Input, Output, Port, Side, State
from dmframe.common.errors import BlockError, DerivativeError, DmframeError
from dmframe.diagram import Diagram
from dmframe.runtime import Controller
from dmframe.simulate import Solver, simulate, simulate_many

States = ClassVar[tuple[State, ...]]

T = 0.07


class Wave(AbstractBlock):
    """y_d = sin(rate t)."""

    side = Side.SOURCE
    inputs = (TIME,)
    outputs = (Output("y_d"),)
    rate: Scalar = Positive(unit="rad/s", default=2.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y_d": ca.sin(p.rate * u.t)})


class Deadbeat(AbstractBlock):
    """Commands an integrator to y_d at the next sample; outputs its input."""

    inputs = (
        Input("y"),
        Input("y_d"),
        Input("y_d_1", ahead_of="y_d"),
        Input("y_d_3", ahead_of="y_d", ahead=3),
        PERIOD,
    )
    outputs = (Output("v", access=Access.COMMANDED), Output("seen"))

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"v": (u.y_d_1 - u.y) / u.T, "seen": u.y_d_3})


class Integrator(AbstractBlock):
    """dy = v."""

    side = Side.PLANT
    inputs = (Input("v"),)
    outputs = (Output("y", access=Access.MEASURED),)
    states = (State("y"),)
    y: Scalar = Real(default=0.4)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": x.y}, rates={"y": u.v})


class Filter(AbstractBlock):
    """A controller's y_d, whose future is unknown."""

    outputs = (Output("y_d"),)
    states = (State("s"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y_d": x.s}, rates={"s": 1 - x.s})


class Differentiating(AbstractBlock):
    """Reads the time derivative of what looks ahead."""

    inputs = (Input("seen"), Input("dseen", derivative_of="seen"))
    states = (State("s"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(rates={"s": u.dseen})


def loop(**others: AbstractBlock) -> Diagram:
    return Diagram.build({"wave": Wave(), "law": Deadbeat(), "cart": Integrator(), **others})


@pytest.mark.parametrize("engine", ["interpreted", "compiled"])
def test_what_looks_ahead_is_the_sources_signal_at_samples_to_come(engine: Any) -> None:
    run = simulate(loop(), 3.0, clock=T, solver=Solver(step=T), engine=engine)
    t = run.time
    np.testing.assert_allclose(run["law.seen"].ravel(), np.sin(2 * (t + 3 * T)), atol=1e-12)
    # dead beat: from the first sample on, the plant is at the path's position; one sample late it would be 0.14 off
    np.testing.assert_allclose(run["cart.y"].ravel()[1:], np.sin(2 * t[1:]), atol=1e-12)


def test_a_batch_of_other_paths_looks_ahead_at_each_its_own() -> None:
    runs = simulate_many(loop(), [{"wave.rate": 1.0}, {"wave.rate": 3.0}], 2.0, clock=T, engine="compiled")
    for run, rate in zip(runs, (1.0, 3.0), strict=True):
        np.testing.assert_allclose(run["law.seen"].ravel(), np.sin(rate * (run.time + 3 * T)), atol=1e-12)  # type: ignore[index, union-attr, unused-ignore]


def test_the_controller_alone_looks_ahead_too() -> None:
    controller = Controller(loop(), T, engine="interpreted")
    controller.measured["cart.y"][:] = 0.1
    assert controller.step(1.3)
    assert controller.commanded["law.v"][0] == pytest.approx((np.sin(2 * (1.3 + T)) - 0.1) / T)


def test_a_constant_trajectory_is_constant_ahead() -> None:
    still = loop().loop.standing(0.5)
    (seen,) = still.acting([next(s.expression for s in still.outputs if s.label == "law.seen")])
    value = ca.Function("seen", [still.p], [still.on_path(seen)])
    assert float(value(still.p_values)) == pytest.approx(np.sin(1.0))


def test_in_continuous_time_it_is_refused() -> None:
    with pytest.raises(DmframeError, match=r"looks ahead at wave\.y_d\(t \+ T\)"):
        simulate(loop(), 1.0, clock=None)


def test_only_a_sources_future_is_known() -> None:
    with pytest.raises(DmframeError, match=r"law\.y_d_1: expected law\.y_d, .* a sample later, .* found path\.y_d"):
        Diagram.build({"path": Filter(), "law": Deadbeat(), "cart": Integrator()})


def test_its_time_derivative_is_refused() -> None:
    with pytest.raises(DerivativeError, match=r"rate\.dseen is a time derivative of a signal that depends on"):
        loop(rate=Differentiating())


@pytest.mark.parametrize(
    ("port", "text"),
    [
        (Input("a_1", ahead_of="b"), "declared b some samples later, unknown; choose from a, a_1"),
        (Input("a_1", ahead_of="a", ahead=0), "is a 0 samples later; expected 1 or more"),
        (Input("a_1", ahead_of="a_1"), "itself a future value"),
        (Input("a_1", ahead_of="a", drawn="normal"), "choose one"),
        (Input("a_1", "", "rad", ahead_of="a"), "another shape or unit"),
    ],
)
def test_a_port_that_cannot_look_ahead_is_refused(port: Input, text: str) -> None:
    class Looking(AbstractBlock):
        inputs = (Input("a"), port)

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations()

    with pytest.raises(DmframeError, match=text):
        Diagram.build({"looking": Looking()})


def test_a_plant_and_an_output_cannot_look_ahead() -> None:
    class Seer(AbstractBlock):
        side = Side.PLANT
        inputs = (Input("a"), Input("a_1", ahead_of="a"))
        outputs = (Output("b"),)

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"b": u.a})

    with pytest.raises(DmframeError) as found:
        Diagram.build({"seer": Seer()})
    texts = [fault.text for fault in found.value.faults]
    assert any("impossible in a plant" in text for text in texts)
    with pytest.raises(TypeError, match="ahead_of"):
        Output("b", ahead_of="a")  # type: ignore[call-arg]
    with (
        pytest.warns(DeprecationWarning, match="instead of Port"),
        pytest.raises(BlockError, match="b: an output has no field ahead_of"),
    ):
        type("Former", (Seer,), {"__module__": __name__, "outputs": (Port("b", ahead_of="a"),)})
