"""Proofs of large sampled loops: cached sums, omitted delay lines, floats with radii."""

from __future__ import annotations

from fractions import Fraction
from typing import Any, ClassVar

import casadi as ca
import numpy as np
import pytest
from flint import arb

from dmframe.analysis import linearise, linearised_period, prove_stability, proved_schur
from dmframe.analysis.enclosed import EnclosedLoop, without_store
from dmframe.analysis.rounding import averaged, unrounded
from dmframe.analysis.sums import Span, conserved, sums_of
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.parameter import Positive, Real, Scalar
from dmframe.block.port import PERIOD, Access, Input, Output, Side, State
from dmframe.diagram import Diagram
from dmframe.exact.ball_matrix import exactly, middles
from dmframe.exact.rounded import Rounded, falls, similar
from dmframe.exact.rows import dense, sparse
from dmframe.graph.graph import Graph
from dmframe.program import read
from dmframe_blocks._averaged_servo import AveragedServo, averaged_servo

States = ClassVar[tuple[State, ...]]

T = 0.05


class Follower(AbstractBlock):
    """A target that integrates the command, and a follower: d target = v, dy = 3 (target - y)."""

    side = Side.PLANT
    inputs = (Input("v"),)
    outputs = (Output("y", access=Access.MEASURED),)
    states = (State("target"), State("y"))

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": x.y}, rates={"target": u.v, "y": 3 * (x.target - x.y)})


class Modelling(AbstractBlock):
    """v = -k y - the mean of W older y; predicts the target, and sums its distance from y."""

    inputs = (Input("y"), PERIOD)
    outputs = (Output("v", access=Access.COMMANDED),)
    states = (
        State("aim", sampled=True),
        State("sent", sampled=True),
        State("z", sampled=True),
        State("ring", "W", sampled=True),
    )
    k: Scalar = Real(default=2.0)
    share: Scalar = Real(default=1.0)
    whole: bool = True
    W: ClassVar[int] = 4

    def sizes(self, robot: Any) -> dict[str, int]:
        return {**super().sizes(robot), "W": self.W}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        v = -p.k * u.y - ca.sum1(x.ring) / self.W
        aim = x.aim + (u.T if self.whole else p.share * u.T) * x.sent
        return Equations(
            outputs={"v": v},
            next={"aim": aim, "sent": v, "z": x.z + u.T * (u.y - x.aim), "ring": ca.vertcat(u.y, x.ring[:-1])},
        )


class LongModelling(Modelling):
    """The same with a long delay line."""

    W: ClassVar[int] = 260


class Rounding(AbstractBlock):
    """y in steps of 0.01."""

    side = Side.PLANT
    inputs = (Input("y"),)
    outputs = (Output("y_m", access=Access.MEASURED, instead_of="y", rounded_by="step"),)
    step: Scalar = Positive(default=0.01)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y_m": p.step * ca.floor(u.y / p.step + 0.5)})


def loop(law: AbstractBlock) -> Diagram:
    return Diagram.build({"law": law, "follower": Follower()})


def proof(diagram: Diagram) -> Any:
    linear = linearise(diagram, clock=T)
    return prove_stability(diagram, linear, linearised_period(linear), T)[0]


def by_hand(k: float, count: int) -> np.ndarray:
    """Target, y, sent command and delay line from sample to sample, without the predicted target and z."""
    A, hold = np.eye(2), np.exp(-3 * T)
    A[1] = [1 - hold, hold]
    B = np.array([T, T - (1 - hold) / 3])  # the target increases by v t, and y lags
    F = np.zeros((count + 3, count + 3))
    F[2] = np.concatenate([[0, -k, 0], np.full(count, -1 / count)])
    F[:2, :2] = A
    F[:2] += np.outer(B, F[2])
    F[3, 1] = 1
    F[4:, 3:-1] = np.eye(count - 1)
    return F


def largest(F: np.ndarray) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(F))))


def test_a_model_of_the_target_differs_from_it_by_what_no_sample_changes() -> None:
    found = proof(loop(Modelling()))
    assert (found.kept, found.resting, found.reason) == (1, 1, "")  # any z is an equilibrium
    expected = largest(by_hand(2.0, 4))
    assert expected < found.radius < expected + 0.002 * (1 - expected)


def test_a_model_that_counts_wrongly_is_not_taken_for_one_that_is_right() -> None:
    found = proof(loop(Modelling(share=1.0001, whole=False)))
    assert found.kept == 0
    assert found.radius is None


@pytest.mark.parametrize(("k", "stable"), [(2.0, True), (60.0, False)])
def test_a_long_memory_is_left_out_of_the_proof(k: float, stable: bool) -> None:
    diagram = loop(LongModelling(k=k))
    linear = linearise(diagram, clock=T)
    enclosed = EnclosedLoop(diagram, linear, T)
    F = enclosed.transition(T)
    assert enclosed.moving > 260
    expected = largest(by_hand(k, 260))
    assert largest(middles(F)) == pytest.approx(expected, abs=1e-6)
    assert proved_schur(F) is (expected < 1) is stable


def test_without_its_store_a_matrix_has_the_same_eigenvalues() -> None:
    random = np.random.default_rng(1)
    core, count = 4, 6
    F = np.zeros((core + 2 * count, core + 2 * count))
    F[:core] = random.normal(size=(core, len(F))) / 4
    for first in (core, core + count):
        F[first, :core] = random.normal(size=core)
        for place in range(first + 1, first + count):
            F[place, place - 1] = 1.0
    reduced = middles(dense(found := without_store(sparse(exactly(F))), len(found)))
    sizes = [np.sort(np.abs(np.linalg.eigvals(A)))[::-1] for A in (F, reduced)]
    np.testing.assert_allclose(sizes[0][:10], sizes[1][:10], atol=1e-6)
    F[core + 1, core + 1] = 0.5  # it depends on itself, and is no delay line
    rows = without_store(sparse(exactly(F)))
    assert largest(middles(dense(rows, len(rows)))) == pytest.approx(largest(F), abs=1e-9)


def test_sums_cancel_and_what_they_conserve_is_found_exactly() -> None:
    x, p, t = ca.SX.sym("x", 3), ca.SX.sym("p"), ca.SX.sym("T")
    u = ca.sin(x[0]) * p
    program = read(ca.Function("f", [x, p, t], [ca.cse(ca.vertcat(t * x[1], u - x[1], (x[2] + t * u) - x[2]))]))
    (places,) = program.stored(range(len(program.nodes)))
    sums = sums_of(program.nodes)
    moves = {state: sums[place] or {} for state, place in enumerate(places)}
    assert conserved(moves) == [{(0, 0): Fraction(1), (1, 1): Fraction(1), (2, 0): Fraction(-1)}]
    assert conserved({k: v for k, v in moves.items() if k != 1}) == []


def test_a_span_states_of_what_a_sum_is_made() -> None:
    span, a, b = Span(), (0, 0), (1, 0)
    assert span.add({a: Fraction(1), b: Fraction(2)}, (7, 0)) is None
    assert span.add({b: Fraction(3)}, (8, 0)) is None
    assert span.factors({a: Fraction(1), b: Fraction(5)}) == {(7, 0): 1, (8, 0): 1}
    assert span.factors({(2, 0): Fraction(1)}) is None
    assert span.add({a: Fraction(1)}, (9, 0)) == {(9, 0): 1, (7, 0): -1, (8, 0): Fraction(2, 3)}


def test_products_in_floats_hold_the_exact_products() -> None:
    random = np.random.default_rng(2)
    numbers = [random.normal(size=(9, 9)) * 10.0 ** random.integers(-9, 9, (9, 9)) for _ in range(2)]
    exact = [np.array([[Fraction(float(v)) for v in row] for row in A], dtype=object) for A in numbers]
    found = Rounded.exactly(numbers[0]) @ Rounded.exactly(numbers[1])
    missed = exact[0] @ exact[1]
    for place in np.ndindex(9, 9):
        assert abs(missed[place] - Fraction(float(found.middle[place]))) <= Fraction(float(found.radius[place]))
    assert np.max(found.radius) > 0


@pytest.mark.parametrize("wanted", [0.3, 0.99, 0.9999, 1.0001, 1.2])
def test_large_matrices_are_proved_exactly_where_they_are_stable(wanted: float) -> None:
    random = np.random.default_rng(3)
    A = random.normal(size=(100, 100))
    A *= wanted / largest(A)
    assert proved_schur(exactly(A)) is (wanted < 1)
    if wanted < 1:
        wide = exactly(A)
        wide[0, 0] = arb(float(A[0, 0]), 300)
        assert not proved_schur(wide)


def test_coordinates_without_an_inverse_prove_nothing() -> None:
    F = Rounded.exactly(np.diag([0.5, 0.2]))
    assert similar(F, np.array([[1.0, 1.0], [1.0, 1.0]])) is None
    assert falls(F)
    assert not falls(Rounded(F.middle, np.full((2, 2), 0.6)))


def test_what_is_rounded_is_taken_in_the_mean() -> None:
    plain = loop(Modelling())
    rounded = Diagram.build({"law": Modelling(), "follower": Follower(), "encoder": Rounding()})
    assert averaged(rounded) == {"encoder.y_m": 0.01}
    assert averaged(plain) == {}
    assert unrounded(plain) is plain
    one, other = (linearise(diagram, clock=T).spectral_radius(T) for diagram in (plain, rounded))
    assert one == pytest.approx(other, abs=1e-9)


@pytest.mark.parametrize("gain", [1.0, 2.5])
def test_the_sampled_law_comes_to_rest_and_not_with_an_estimator_that_overshoots(
    gain: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    def projected(self: AveragedServo, theta: Any, h: Any, g: Any, Gamma: Any, nu: Any) -> Any:
        epsilon = g - self._sums(h * theta)
        return theta + gain * Gamma * h * self._each(epsilon / (nu + self._sums(h * Gamma * h)))

    monkeypatch.setattr(AveragedServo, "projected", projected)
    averaged_servo.cache_clear()
    graph = Graph.read("ur10_slow_sampled", ["inverse.replay=1"])
    diagram = graph.diagram
    averaged_servo.cache_clear()
    linear = linearise(diagram, start=graph.start, clock=0.09)
    enclosed = EnclosedLoop(diagram, linear, 0.09)
    F = enclosed.transition(0.09)
    assert enclosed.kept == 3
    radius = largest(middles(F))
    assert radius == pytest.approx(linear.spectral_radius(0.09), abs=1e-6)
    assert proved_schur(F) is (gain < 2)
    if gain < 2:  # the pole of the task, as in an independent prototype
        assert radius == pytest.approx(0.98956, abs=1e-5)
