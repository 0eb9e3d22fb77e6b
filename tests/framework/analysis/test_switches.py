"""Switching functions at a set-point: linear inside a piece, undecided on an edge; and a proof of the map is
withdrawn if another analysis contradicts it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, ClassVar

import casadi as ca
import numpy as np
import pytest

from dmframe.analysis import linearise, linearised_period, prove_stability, stability_proof
from dmframe.analysis import moves as moves_room
from dmframe.analysis.rounding import averaged
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.parameter import Positive, Real, Scalar
from dmframe.block.port import PERIOD, Access, Input, Output, Side, State
from dmframe.common.errors import BlockError, EngineError
from dmframe.diagram import ClosedLoop, Diagram

States = ClassVar[tuple[State, ...]]
Rule = Callable[[Any], Any]

T = 0.05
RULES: dict[str, Rule] = {"": lambda y: -2 * y}


class Law(AbstractBlock):
    """v = g(y), or g of the measurement of the previous sample."""

    inputs = (Input("y"),)
    outputs = (Output("v", access=Access.COMMANDED),)
    states = (State("old", sampled=True),)
    rule: str = ""

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"v": RULES[self.rule](u.y) + 0.1 * x.old}, next={"old": u.y})


class Cart(AbstractBlock):
    """dy = v - y."""

    side = Side.PLANT
    inputs = (Input("v"),)
    outputs = (Output("y", access=Access.MEASURED),)
    states = (State("y"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": x.y}, rates={"y": u.v - x.y})


def loop(rule: Rule, **blocks: AbstractBlock) -> Diagram:
    RULES["now"] = rule
    return Diagram.build({"law": Law(rule="now"), "cart": Cart(), **blocks})


def proof(diagram: Diagram) -> Any:
    linear = linearise(diagram, clock=T)
    return linear, prove_stability(diagram, linear, linearised_period(linear), T)[0]


def by_hand(slope: float) -> float:
    """The spectral radius with v = slope y + old / 10."""
    hold = math.exp(-T)
    A = np.array([[0, 1], [0.1 * (1 - hold), hold + (1 - hold) * slope]])
    return float(np.max(np.abs(np.linalg.eigvals(A))))


def wrapped(y: Any) -> Any:
    return y - 2 * math.pi * ca.floor(y / (2 * math.pi) + 0.5)


INSIDE: dict[str, tuple[Rule, float]] = {
    "a wrapped angle, fed back the wrong way": (lambda y: 3 * wrapped(y), 3),
    "a wrapped angle": (lambda y: -3 * wrapped(y), -3),
    "wrapped by a remainder": (lambda y: -3 * ca.remainder(y, 2 * math.pi), -3),
    "wrapped by a rest": (lambda y: 3 * (ca.fmod(y + 9, 6) - 3), 3),
    "a rest on both sides of zero": (lambda y: -3 * ca.fmod(y, 1), -3),
    "rounded, within a step": (lambda y: 0.5 * ca.floor(y / 0.5 + 0.5) - y, -1),
    "rounded up": (lambda y: ca.ceil(y - 0.5) - y, -1),
    "signs": (lambda y: -2 * y * ca.sign(y + 1) + 2 * ca.fmax(ca.fabs(y + 2) - 2, -1) - ca.copysign(y + 1, 5) + 1, -1),
    "a dead zone about the set-point": (lambda y: -5 * ca.sign(y) * ca.fmax(ca.fabs(y) - 0.1, 0) - y, -1),
    "a choice": (lambda y: ca.if_else(ca.logic_and(y < 1, y > -1), -2 * y, 5 * y), -2),
    "the other choice": (lambda y: ca.if_else(ca.logic_or(y > 1, y < -1), -2 * y, 3 * y), 3),
    "a saturation that acts": (lambda y: ca.fmin(ca.fmax(-9 * y - 3, -1), 1) + 1, 0),
}


@pytest.mark.parametrize("name", INSIDE)
def test_inside_a_piece_a_switch_is_what_it_is_there(name: str) -> None:
    rule, slope = INSIDE[name]
    linear, proved = proof(loop(rule))
    wanted = by_hand(slope)
    assert linear.spectral_radius(T) == pytest.approx(wanted, abs=1e-9)
    assert linear.kinks == ()
    if wanted < 1:
        assert wanted < proved.radius < 1
    else:
        assert (proved.radius, proved.period, proved.reason) == (None, None, "it is unstable in floating point")


@pytest.mark.parametrize(
    ("rule", "found"),
    [
        (lambda y: -ca.floor(y), "floor"),
        (lambda y: -2 * (y - ca.floor(y)), "floor"),
        (lambda y: 1e-3 * ca.ceil(y + 4), "ceil"),
        (lambda y: -ca.sign(y), "sign"),
        (lambda y: ca.if_else(y > 0, -1, 0), "<"),
        (lambda y: ca.if_else(ca.logic_not(y <= 0), -1, 0), "<="),
        (lambda y: -ca.remainder(y + 0.5, 1) + 0.5, "remainder"),
        (lambda y: -ca.fmod(y + 2, 1), "fmod"),
        (lambda y: ca.copysign(1, y) - 1, "copysign"),
        (lambda y: ca.atan2(y, -1) - math.pi, "atan2"),
        (lambda y: ca.if_else(y == 0, 0, -1), "=="),
    ],
)
def test_on_an_edge_there_is_no_slope(rule: Rule, found: str) -> None:
    diagram = loop(rule)
    with pytest.raises(EngineError, match=rf"found that {found} jumps there: it has no derivative"):
        linearise(diagram, np.zeros(2), clock=T)


def test_where_the_slope_alone_jumps_the_numbers_are_of_one_side_and_nothing_is_proved() -> None:
    for rule, kink in ((lambda y: ca.if_else(y > 0, -2 * y, -y), "<"), (lambda y: -ca.fabs(y), "fabs")):
        linear, proved = proof(loop(rule))
        assert linear.kinks == (kink,)
        assert (proved.radius, proved.period) == (None, None)
        assert "switches" in proved.reason


class Rounding(AbstractBlock):
    """Measures in steps, or declares to do so."""

    side = Side.PLANT
    inputs = (Input("y"), Input("eta", drawn="normal"))
    outputs = (Output("y_m", access=Access.MEASURED, instead_of="y", rounded_by="step"),)
    step: Scalar = Positive(default=0.01)
    noise: Scalar = Real(default=0.001)
    lie: str = ""

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        y, step = u.y + p.noise * u.eta, p.step
        read = {
            "": step * ca.floor(y / step + 0.5),
            "the rest": y - step * ca.floor(y / step + 0.5),
            "no half": step * ca.floor(y / step),
            "up": step * ca.ceil(y / step + 0.5),
            "another step": 2 * step * ca.floor(y / step + 0.5),
            "another signal": step * ca.floor(-3 * y / step + 0.5),
            "twice": step * ca.floor(step * ca.floor(y / step + 0.5) / step + 0.5),
            "nothing": y,
        }[self.lie]
        return Equations(outputs={"y_m": read})


def test_only_a_quantiser_that_is_declared_is_averaged() -> None:
    diagram = loop(lambda y: -2 * y, encoder=Rounding())
    assert averaged(diagram) == {"encoder.y_m": 0.01}
    linear, proved = proof(diagram)
    assert linear.spectral_radius(T) == pytest.approx(by_hand(-2), abs=1e-9)
    assert by_hand(-2) < proved.radius < 1


@pytest.mark.parametrize("lie", ["the rest", "no half", "up", "another step", "another signal", "twice", "nothing"])
def test_a_block_that_declares_what_is_not_a_rounding_is_refused(lie: str) -> None:
    with pytest.raises(
        BlockError, match=r"encoder: declares that y_m is rounded by step, expected step floor\(y / step"
    ):
        linearise(loop(lambda y: -2 * y, encoder=Rounding(lie=lie)), clock=T)


def test_a_declared_step_does_not_excuse_other_roundings() -> None:
    diagram = loop(lambda y: 3 * wrapped(y), encoder=Rounding())
    linear, proved = proof(diagram)
    assert linear.spectral_radius(T) == pytest.approx(by_hand(3), abs=1e-9)
    assert proved.radius is None


class Second(AbstractBlock):
    """v = -z, dz/dt = y - z with a second term in its step, which decides stability alone and in the loop."""

    inputs = (Input("y"), PERIOD)
    outputs = (Output("v", access=Access.COMMANDED),)
    states = (State("z"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"v": -x.z}, rates={"z": u.y - x.z}, second={"z": 50 * x.z - 20 * u.y})


def test_the_second_term_of_a_step_is_in_the_floats_and_in_the_proof() -> None:
    diagram = Diagram.build({"law": Second(), "cart": Cart()})
    for period in (T, 0.01):
        hold = math.exp(-period)
        A = np.array([[1 - period + 50 * period**2, period - 20 * period**2], [hold - 1, hold]])
        wanted = float(np.max(np.abs(np.linalg.eigvals(A))))
        linear = linearise(diagram, clock=period)
        found = prove_stability(diagram, linear, linearised_period(linear), period)[0]
        assert linear.spectral_radius(period) == pytest.approx(wanted, abs=1e-9)
        assert not found.disagrees
        assert (found.radius is not None) == (wanted < 1)
        if found.radius is not None:
            assert wanted < found.radius


def _other_moves(loop: ClosedLoop, own: Any = moves_room.moves) -> Any:
    return own(loop) * ca.SX([1.0, 1.2])


@pytest.mark.parametrize(
    ("room", "name", "other"),
    [
        (moves_room, "moves", _other_moves),
        (moves_room, "moves", lambda loop, own=moves_room.moves: own(loop) * ca.SX([1.0, 0.5])),
        (stability_proof, "tick_jacobian", lambda *_, **__: np.diag([0.5, 0.5])),
    ],
)
def test_a_proof_of_another_map_is_withdrawn(room: Any, name: str, other: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    diagram = loop(lambda y: -2 * y)
    assert proof(diagram)[1].radius < 1
    monkeypatch.setattr(room, name, other)
    _, found = proof(diagram)
    assert (found.radius, found.period, found.disagrees) == (None, None, True)
    assert "the proof is withdrawn" in found.reason
