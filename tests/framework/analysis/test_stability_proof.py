"""Stability proofs of sampled loops, compared with python-control, SciPy and runs; and loops not to be proved."""

from __future__ import annotations

from functools import cache
from typing import Any, ClassVar

import casadi as ca
import numpy as np
import pytest
import scipy
from flint import arb, arb_mat

from dmframe.analysis import (
    linearise,
    linearised_period,
    prove_stability,
    proved_schur,
    tick_jacobian,
)
from dmframe.analysis.enclosed import EnclosedLoop
from dmframe.analysis.memory import without_memory
from dmframe.analysis.minimum_cut import Cut
from dmframe.analysis.moves import split_moves
from dmframe.analysis.set_point import frozen
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.parameter import Box, Interval, Real, Scalar
from dmframe.block.port import PERIOD, Access, Input, Output, Side, State
from dmframe.common.errors import EngineError
from dmframe.diagram import Diagram
from dmframe.exact.ball_matrix import exactly, middles, radii
from dmframe.exact.balls import UndecidedError, ball
from dmframe.graph.graph import Graph
from dmframe.simulate import Solver

States = ClassVar[tuple[State, ...]]

T = 0.05


class SampledPi(AbstractBlock):
    """v = -k (y - r) - i, i+ = i + T (y - r): in discrete time."""

    inputs = (Input("y"), PERIOD)
    outputs = (Output("v", access=Access.COMMANDED),)
    states = (State("i", sampled=True, box="i_box"),)
    k: Scalar = Real(default=2.0)
    r: Scalar = Real(default=0.0)
    i_box: Box = Interval()

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"v": -p.k * (u.y - p.r) - x.i}, next={"i": x.i + u.T * (u.y - p.r)})


class Late(AbstractBlock):
    """Outputs the command of the previous sample."""

    side = Side.PLANT
    inputs = (Input("v"), Input("n", drawn="normal"))
    outputs = (Output("v_late"),)
    states = (State("late", sampled=True),)
    noise: Scalar = Real(default=0.3)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"v_late": x.late + p.noise * u.n}, next={"late": u.v})


class Cart(AbstractBlock):
    """dy = v_late - y/2 - y^3."""

    side = Side.PLANT
    inputs = (Input("v_late"),)
    outputs = (Output("y", access=Access.MEASURED),)
    states = (State("y"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": x.y}, rates={"y": u.v_late - x.y / 2 - x.y**3})


class Learner(AbstractBlock):
    """Two estimates that move with one error, in proportions that depend on the state."""

    inputs = (Input("y"),)
    outputs = (Output("v", access=Access.COMMANDED),)
    states = (State("a"), State("b"))
    hidden: bool = False

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        other = u.y * u.y + 2 * u.y if not self.hidden else (u.y + 1) * (u.y + 1) - 1
        return Equations(outputs={"v": -u.y - x.a - x.a * x.b}, rates={"a": u.y * (1 + x.b * x.b), "b": other})


class Remembering(AbstractBlock):
    """v = -k y - (the mean of y in the last samples); counts samples, and sums a signal that no block reads."""

    inputs = (Input("y"),)
    outputs = (Output("v", access=Access.COMMANDED),)
    states = (
        State("rows", "W 2", sampled=True),
        State("count", sampled=True),
        State("bias", sampled=True),
        State("sum", sampled=True),
    )
    W: ClassVar[int] = 30

    def sizes(self, robot: Any) -> dict[str, int]:
        return {**super().sizes(robot), "W": self.W}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        mean = ca.sum1(x.rows @ ca.DM([1.0, -0.5])) / self.W
        new = ca.horzcat(u.y, u.y * u.y + u.y)
        return Equations(
            outputs={"v": -2 * u.y - mean * ca.fmin(1, x.count)},
            next={
                "rows": ca.vertcat(new, x.rows[:-1, :]),
                "count": x.count + 1,
                "bias": x.bias,
                "sum": x.sum + x.bias,
            },
        )


def loop(r: float = 0.0, **options: Any) -> Diagram:
    return Diagram.build({"law": SampledPi(r=r, **options), "late": Late(), "cart": Cart()})


def by_hand(period: float, y: float = 0.0, k: float = 2.0) -> np.ndarray:
    """States i, late, y of the loop at a point y, by python-control."""
    import control

    cart = control.c2d(control.ss([[-0.5 - 3 * y * y]], [[1.0]], [[1.0]], [[0.0]]), period, "zoh")
    return np.array([[1, 0, period], [-1, 0, -k], [0, cart.B[0, 0], cart.A[0, 0]]])


def radius(period: float) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(by_hand(period)))))


def proof(diagram: Diagram, clock: float | None) -> Any:
    linear = linearise(diagram, clock=clock)
    return prove_stability(diagram, linear, linearised_period(linear), clock)[0]


@cache
def packaged(name: str) -> tuple[Diagram, Any]:
    graph = Graph.read(name)
    return graph.diagram, graph


@pytest.mark.parametrize("r", [0.0, 0.7])
@pytest.mark.parametrize("period", [0.01, T, 0.4])
def test_a_loop_that_runs_on_a_clock_alone_is_linearised_as_in_python_control(r: float, period: float) -> None:
    linear = linearise(loop(r), clock=period)
    order = [linear.states.index(name) for name in ("law.i[0]", "late.late[0]", "cart.y[0]")]
    assert linear.point[order] == pytest.approx([-(r / 2 + r**3), r / 2 + r**3, r], abs=1e-9)
    wanted = by_hand(period, r)
    np.testing.assert_allclose(linear.sampled(period)[np.ix_(order, order)], wanted, atol=1e-8)
    found = tick_jacobian(loop(r), linear, period, Solver(step=period / 400))
    np.testing.assert_allclose(found[np.ix_(order, order)], wanted, atol=1e-8)
    assert linear.at_rest == 0
    assert not len(linear.poles)


def test_the_largest_period_of_a_sampled_loop_is_where_its_radius_crosses_one() -> None:
    expected = scipy.optimize.brentq(lambda period: radius(period) - 1, 0.1, 2.0)
    found = linearised_period(linearise(loop(), clock=T))
    assert found.stable <= expected <= found.unstable
    proved = proof(loop(), T)
    assert 0.999 * expected < proved.period < expected
    assert radius(T) < proved.radius < radius(T) + 0.002 * (1 - radius(T))
    assert (proved.directions, proved.resting, proved.reason) == (3, 0, "")


def test_without_its_clock_a_sampled_loop_has_no_set_point() -> None:
    with pytest.raises(EngineError, match=r"set-point: expected a clock, found none; law\.i is a sampled state"):
        linearise(loop())


@pytest.mark.parametrize("size", [1, 4, 17])
def test_random_matrices_are_proved_exactly_where_they_are_stable(size: int) -> None:
    random = np.random.default_rng(size)
    for wanted in (0.3, 0.99, 0.9999999, 1.0000001, 1.2):
        A = random.normal(size=(size, size))
        A *= wanted / np.max(np.abs(np.linalg.eigvals(A)))
        assert proved_schur(exactly(A)) is (wanted < 1)
        if wanted < 1:
            assert proved_schur(exactly(A), ball(round(wanted + 1e-6, 8)))
            assert not proved_schur(exactly(A), ball(round(wanted - 1e-6, 8)))


def test_a_matrix_that_is_far_from_normal_is_proved() -> None:
    A = np.diag(np.full(6, 0.9)) + np.diag(np.full(5, 3e3), 1)
    assert proved_schur(exactly(A))
    A[5, 0] = 1e-14  # (l - 0.9)^6 = 3e3^5 1e-14 = 2430
    assert not proved_schur(exactly(A))


@pytest.mark.parametrize("size", [3, 90])
def test_numbers_too_large_for_floats_are_not_proved_and_no_fault(size: int) -> None:
    for part in ("middle", "radius"):
        F, large = exactly(np.eye(size) / 2), arb(10) ** 400
        F[0, 1] = large if part == "middle" else arb(0, large)
        # a triangular matrix: stable, without an enclosure in floats; with few rows the balls can prove it
        assert not proved_schur(F) or (size, part) == (3, "radius")


def test_an_enclosure_with_an_unstable_matrix_in_it_is_not_proved() -> None:
    wide = exactly(np.diag([0.5, 0.999]))
    assert proved_schur(wide)
    wide[1, 1] = arb(0.999, 0.0010001)
    assert not proved_schur(wide)


@pytest.mark.parametrize("name", ["arm2_joint", "pendulum", "ur10_fast_tuned"])
def test_what_moves_in_a_graph_has_the_eigenvalues_of_its_tick(name: str) -> None:
    diagram, graph = packaged(name)
    clock = graph.file.clock or 0.002
    linear = linearise(diagram, start=graph.start)
    loop = EnclosedLoop(diagram, linear, clock)
    F = loop.transition(clock)
    assert len(linear.states) - loop.moving == linear.at_rest
    assert np.max(radii(F)) < 1e-45
    found = np.concatenate([np.linalg.eigvals(middles(F)), np.ones(linear.at_rest)])
    wanted = np.linalg.eigvals(linear.sampled(clock))
    np.testing.assert_allclose(np.sort(np.abs(found)), np.sort(np.abs(wanted)), atol=1e-6)  # multiple poles at 1
    still = linear.sampled_poles(clock)
    np.testing.assert_allclose(np.sort(np.abs(found))[: len(still)], np.sort(np.abs(still)), atol=1e-9)
    proved = prove_stability(diagram, linear, linearised_period(linear), clock)[0]
    assert linear.spectral_radius(clock) < proved.radius < 1
    assert proved.resting == linear.at_rest


def test_a_gain_that_makes_the_loop_unstable_is_not_proved() -> None:
    assert proof(loop(k=2.0), T).radius < 1
    found = proof(loop(k=60.0), T)
    assert found.radius is None
    assert found.reason == "it is unstable in floating point"
    assert found.period < T


def test_directions_in_which_nothing_is_excited_are_split_off_by_structure_alone() -> None:
    learner = Diagram.build({"law": Learner(), "late": Late(), "cart": Cart()})
    found = proof(learner, T)
    assert (found.directions, found.resting) == (3, 1)  # y, late, v; a and b move with y
    assert found.radius < 1
    hidden = proof(Diagram.build({"law": Learner(hidden=True), "late": Late(), "cart": Cart()}), T)
    assert hidden.radius is None
    assert hidden.reason == "the signals that vanish at rest do not determine the equilibrium"


def test_a_split_that_omits_a_signal_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    diagram = loop()
    linear = linearise(diagram, clock=T)
    still, p = frozen(diagram).loop, [ball(float(v)) for v in diagram.loop.p_values]
    assert split_moves(still, linear.point, p, ball(T)).count == 3
    found = Cut.found
    monkeypatch.setattr(Cut, "found", lambda self: (found(self)[0][1:], {}))
    with pytest.raises(UndecidedError, match="do not vanish structurally"):
        split_moves(still, linear.point, p, ball(T))


def test_a_state_at_the_end_of_its_box_is_reported() -> None:
    inside = proof(loop(0.7, i_box=[-1.0, 1.0]), T)
    assert inside.radius < 1
    start = -(0.7 / 2 + 0.7**3)
    assert proof(loop(0.7, i_box=[start, 1.0]), T).reason == "law.i is at the boundary of its set at the equilibrium"


def test_a_long_memory_is_left_out_and_a_count_and_a_drift_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("linear.LARGE", "period.LARGE", "enclosed.MOST_STATES"):
        monkeypatch.setattr(f"dmframe.analysis.{name}", 50)
    diagram = Diagram.build({"law": Remembering(), "late": Late(), "cart": Cart()})
    linear = linearise(diagram, clock=T)
    assert len(linear.states) == 65
    # constant: the sum, and the count, which is large long after the start; the bias drives the sum
    assert (linear.at_rest, linear.ramp_modes) == (2, 1)
    whole = np.abs(np.linalg.eigvals(linear.sampled(T)))
    expected = np.max(whole[np.abs(whole - 1) > 1e-6])
    assert linear.spectral_radius(T) == pytest.approx(expected, abs=1e-9)
    assert len(without_memory(linear.sampled(T))) == 35  # one sum of a sample is read, of two numbers
    bracket = linearised_period(linear)
    assert (bracket.stable, bracket.unstable) == (T, np.inf)
    found = prove_stability(diagram, linear, bracket, T)[0]
    assert found.reason == "it has 65 states; the proof is limited to 50"


def test_a_drift_is_not_proved_to_come_to_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Remembering, "W", 3)
    found = proof(Diagram.build({"law": Remembering(), "late": Late(), "cart": Cart()}), T)
    assert found.radius is None
    assert found.reason == "it has 1 ramp modes without a restoring term"


class Switching(AbstractBlock):
    """v = k y + z, with an estimate s that moves with y; k and z switch, at rest or later, to unstable values."""

    inputs = (Input("y"),)
    outputs = (Output("v", access=Access.COMMANDED),)
    states = tuple(State(name, sampled=True) for name in ("s", "r", "z", "n"))
    lie: str = ""

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        s, n, k, z = x.s, x.n, ca.SX(-1), x.z / 2
        match self.lie:
            case "smooth":
                k = 6 * s**2 - 1
            case "far":
                k = ca.if_else(s < 1, -1, 5) + ca.if_else(n > 5, 0, 5) + ca.if_else(s == 1, 5, 0) + ca.sign(s - 1) + 1
            case "==":
                k = ca.if_else(s == 0, -1, 5)
            case "<=":
                k = ca.if_else(s <= 0, -1, 5)
            case "<":
                k = ca.if_else(s < 0, 5, -1)
            case "not":
                k = 5 - 6 * ca.logic_not(s)
            case "sign":
                k = 6 * ca.sign(s) ** 2 - 1
            case "of two":
                k = ca.if_else(s == x.r, -1, 5)
            case "in a guard":
                k = ca.if_else(10 * (s > 0) < 5, -1, 5)
            case "of a signal":
                z = x.z / 2 + 2 * x.z * (u.y > 0)
            case "fabs":
                z = x.z / 2 + 5 * ca.fabs(x.z)
            case "with the count":
                k = 3 - 6 * ca.cos(n * 3.141592653589793e-6) ** 2
            case "later":
                k = ca.if_else(n < 2e6, -1, 5)
        steps = n * (n - 1) * (n - 7) if self.lie == "no count" else -2 if self.lie == "downwards" else 0
        r = x.r + u.y / 10 if self.lie == "of two" else x.r
        return Equations(outputs={"v": k * u.y + z}, next={"s": s + u.y, "r": r, "z": z, "n": n + 1 + steps})


def switching(lie: str) -> arb_mat:
    diagram = Diagram.build({"law": Switching(lie=lie), "late": Late(noise=0), "cart": Cart()})
    return EnclosedLoop(diagram, linearise(diagram, clock=T), T).transition(T)


@pytest.mark.parametrize("lie", ["", "smooth", "far"])
def test_what_is_smooth_where_it_rests_and_what_switches_far_from_there_are_proved(lie: str) -> None:
    assert proved_schur(switching(lie))


@pytest.mark.parametrize(
    ("lie", "reason"),
    [
        ("==", "its equilibrium is at a point where == switches"),
        ("<=", "its equilibrium is at a point where <= switches"),
        ("<", "its equilibrium is at a point where < switches"),
        ("not", "its equilibrium is at a point where not switches"),
        ("sign", "its equilibrium is at a point where sign switches"),
        ("of two", "its equilibrium is at a point where == switches"),
        ("in a guard", "its equilibrium is at a point where < switches"),
        ("of a signal", "its equilibrium is at a point where < switches"),
        ("fabs", "its equilibrium is at a point where fabs switches"),
        ("with the count", "it has no equilibrium: its rates depend on a counter that grows with each sample"),
        ("later", "its equilibrium is at a switching point of a comparison"),
    ],
)
def test_where_a_slope_does_not_bound_what_is_near_or_comes_later_nothing_is_proved(lie: str, reason: str) -> None:
    with pytest.raises(UndecidedError, match=reason):
        switching(lie)


def test_a_number_that_grows_otherwise_or_falls_is_no_count() -> None:
    assert not proved_schur(switching("no count"))
    with pytest.raises(EngineError, match=r"found none; law\.n still changes by -1"):
        switching("downwards")


def test_an_equilibrium_that_is_invalid_is_not_proved() -> None:
    diagram = loop(0.7)
    linear = linearise(diagram, clock=T)
    moved = linearise(diagram, linear.point + 0.2, clock=T)
    bracket = linearised_period(linear)
    # Newton's method still finds the equilibrium; its distance is reported
    assert prove_stability(diagram, moved, bracket, T)[0].within == pytest.approx(0.2, rel=0.01)
