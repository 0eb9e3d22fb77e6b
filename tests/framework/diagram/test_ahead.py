"""Inputs that are a source's signal some samples later: against the source's own formula."""

from __future__ import annotations

from typing import Any, ClassVar

import casadi as ca
import numpy as np
import pytest

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.diagram import Diagram
from dmframe.errors import DerivativeError, DmframeError
from dmframe.parameter import Positive, Real, Scalar
from dmframe.port import PERIOD, TIME, Access, Port, Side, State
from dmframe.runtime import Controller
from dmframe.simulate import Solver, simulate, simulate_many

Ports = ClassVar[tuple[Port, ...]]
States = ClassVar[tuple[State, ...]]

T = 0.07


class Wave(AbstractBlock):
    """y_d = sin(rate t)."""

    side: ClassVar[Side] = Side.SOURCE
    inputs: Ports = (TIME,)
    outputs: Ports = (Port("y_d"),)
    rate: Scalar = Positive(unit="rad/s", default=2.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y_d": ca.sin(p.rate * u.t)})


class Deadbeat(AbstractBlock):
    """Puts an integrator on y_d at the next sample; hands out what it saw."""

    inputs: Ports = (
        Port("y"),
        Port("y_d"),
        Port("y_d_1", ahead_of="y_d"),
        Port("y_d_3", ahead_of="y_d", ahead=3),
        PERIOD,
    )
    outputs: Ports = (Port("v", access=Access.COMMANDED), Port("seen"))

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"v": (u.y_d_1 - u.y) / u.T, "seen": u.y_d_3})


class Integrator(AbstractBlock):
    """dy = v."""

    side: ClassVar[Side] = Side.PLANT
    inputs: Ports = (Port("v"),)
    outputs: Ports = (Port("y", access=Access.MEASURED),)
    states: States = (State("y"),)
    y: Scalar = Real(default=0.4)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": x.y}, rates={"y": u.v})


class Filter(AbstractBlock):
    """A controller's y_d, of which nobody knows the future."""

    outputs: Ports = (Port("y_d"),)
    states: States = (State("s"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y_d": x.s}, rates={"s": 1 - x.s})


class Differentiating(AbstractBlock):
    """Asks for the time derivative of what looks ahead."""

    inputs: Ports = (Port("seen"), Port("dseen", derivative_of="seen"))
    states: States = (State("s"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(rates={"s": u.dseen})


def loop(**others: AbstractBlock) -> Diagram:
    return Diagram.build({"wave": Wave(), "law": Deadbeat(), "cart": Integrator(), **others})


@pytest.mark.parametrize("engine", ["interpreted", "compiled"])
def test_what_looks_ahead_is_the_sources_signal_at_samples_to_come(engine: Any) -> None:
    run = simulate(loop(), 3.0, clock=T, solver=Solver(step=T), engine=engine)
    t = run.time
    np.testing.assert_allclose(run["law.seen"].ravel(), np.sin(2 * (t + 3 * T)), atol=1e-12)
    # dead beat: from the first sample on, the plant is where the path then is; a step late it would be 0.14 off
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


def test_a_trajectory_that_stands_still_stands_still_ahead() -> None:
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
    with pytest.raises(DerivativeError, match=r"rate\.dseen is a time derivative of what looks ahead"):
        loop(rate=Differentiating())


@pytest.mark.parametrize(
    ("port", "text"),
    [
        (Port("a_1", ahead_of="b"), "declared b some samples later, unknown; choose from a, a_1"),
        (Port("a_1", ahead_of="a", ahead=0), "is a 0 samples later; expected 1 or more"),
        (Port("a_1", ahead_of="a_1"), "which looks ahead itself"),
        (Port("a_1", ahead_of="a", drawn="normal"), "choose one"),
        (Port("a_1", "", "rad", ahead_of="a"), "another shape or unit"),
    ],
)
def test_a_port_that_cannot_look_ahead_is_refused(port: Port, text: str) -> None:
    class Looking(AbstractBlock):
        inputs: Ports = (Port("a"), port)

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations()

    with pytest.raises(DmframeError, match=text):
        Diagram.build({"looking": Looking()})


def test_a_plant_and_an_output_cannot_look_ahead() -> None:
    class Seer(AbstractBlock):
        side: ClassVar[Side] = Side.PLANT
        inputs: Ports = (Port("a"), Port("a_1", ahead_of="a"))
        outputs: Ports = (Port("b", ahead_of="a"),)

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"b": u.a})

    with pytest.raises(DmframeError) as found:
        Diagram.build({"seer": Seer()})
    texts = [fault.text for fault in found.value.faults]
    assert any("a plant has no foresight" in text for text in texts)
    assert any("the output b is a some samples later" in text for text in texts)
