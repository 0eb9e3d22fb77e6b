"""Least-squares steps over samples: their exact effect on V, and a block that uses them, with false statements."""

from __future__ import annotations

import random
from dataclasses import replace
from fractions import Fraction
from typing import Any, ClassVar

import casadi as ca
import numpy as np
import pytest

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.certificate import Certificate, LeastSquaresSteps, PlantIdentity
from dmframe.block.parameter import Positive, Scalar
from dmframe.block.port import PERIOD, Access, Input, Output, Side, State
from dmframe.block.steps import packed_size, unpacked
from dmframe.certify import Verdict, verify
from dmframe.diagram import Diagram
from dmframe.exact.rational import evaluate
from dmframe.prove.definite import is_semidefinite
from dmframe.simulate import simulate

States = ClassVar[tuple[State, ...]]
Matrix = list[list[Fraction]]


def number(rng: random.Random) -> Fraction:
    return Fraction(rng.randint(-9, 9), rng.randint(1, 7))


def column(rng: random.Random, size: int) -> list[Fraction]:
    return [number(rng) for _ in range(size)]


def dot(a: list[Fraction], b: list[Fraction]) -> Fraction:
    return sum((x * y for x, y in zip(a, b, strict=True)), Fraction())


def times(A: Matrix, x: list[Fraction]) -> list[Fraction]:
    return [dot(row, x) for row in A]


def plus(A: Matrix, B: Matrix, share: Fraction = Fraction(1)) -> Matrix:
    return [[a + share * b for a, b in zip(left, right, strict=True)] for left, right in zip(A, B, strict=True)]


def outer(x: list[Fraction]) -> Matrix:
    return [[a * b for b in x] for a in x]


def inverse(A: Matrix) -> Matrix:
    """Gauss-Jordan elimination."""
    n = len(A)
    rows = [[*row, *(Fraction(i == j) for j in range(n))] for i, row in enumerate(A)]
    for i in range(n):
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for j in (j for j in range(n) if j != i):
            rows[j] = [value - rows[j][i] * own for value, own in zip(rows[j], rows[i], strict=True)]
    return [row[n:] for row in rows]


def form(x: list[Fraction], W: Matrix) -> Fraction:
    return dot(x, times(W, x))


def positive(rng: random.Random, size: int) -> Matrix:
    """A sum of one more random square than the size, and a small multiple of the identity."""
    found = [[Fraction(i == j, 5) for j in range(size)] for i in range(size)]
    for _ in range(size + 1):
        found = plus(found, outer(column(rng, size)))
    return found


@pytest.mark.parametrize("seed", range(4))
def test_a_step_moves_v_by_what_it_states_for_every_metric(seed: int) -> None:
    rng, n = random.Random(seed), 4
    W, nu, h, theta, true = positive(rng, n), Fraction(1, 9), column(rng, n), column(rng, n), column(rng, n)
    eta, error = 1 + abs(number(rng)), [a - b for a, b in zip(theta, true, strict=True)]
    missed, learnt = eta - dot(h, error), times(inverse(W), h)
    size = nu + dot(h, learnt)
    after, heavier = [x + a * missed / size for x, a in zip(error, learnt, strict=True)], plus(W, outer(h), 1 / nu)
    change = form(after, heavier) - form(error, W)
    assert change == -(missed**2) / size + eta**2 / nu
    assert change != -(missed**2) / size + eta**2 / size  # the floor is the only weight
    for learnt_otherwise in (times(inverse(heavier), h), [-a for a in learnt]):
        other = [x + a * missed / size for x, a in zip(error, learnt_otherwise, strict=True)]
        assert form(other, heavier) - form(error, W) != change


@pytest.mark.parametrize("seed", range(4))
def test_a_face_met_along_the_nearest_line_takes_nothing_farther_and_a_cut_may(seed: int) -> None:
    rng, n = random.Random(seed), 4
    W, theta = positive(rng, n), [3 + abs(number(rng)) for _ in range(n)]
    P, inside = inverse(W), [min(number(rng), Fraction(1)) for _ in range(n)]  # the faces are at 1
    distance = form([a - b for a, b in zip(theta, inside, strict=True)], W)
    for i in range(n):
        beyond = max(theta[i] - 1, Fraction(0))
        theta = [x - P[j][i] * beyond / P[i][i] for j, x in enumerate(theta)]
        now = form([a - b for a, b in zip(theta, inside, strict=True)], W)
        assert now <= distance
        distance = now


def test_a_cut_takes_an_estimate_farther_in_many_metrics() -> None:
    rng, farther = random.Random(1), 0
    for _ in range(50):
        error, W = column(rng, 3), positive(rng, 3)
        farther += form([*error[:-1], error[-1] / 2], W) > form(error, W)
    assert farther > 5


@pytest.mark.parametrize("share", [Fraction(0), Fraction(1, 2), Fraction(1)])
def test_what_is_forgotten_takes_away_from_v_and_leaves_the_gain_below_its_start(share: Fraction) -> None:
    rng, n = random.Random(8), 3
    start = [[Fraction(i == j) * (i + 2) for j in range(n)] for i in range(n)]
    G = [[Fraction()] * n for _ in range(n)]
    for _ in range(5):
        more = plus(G, outer(column(rng, n)), Fraction(4))
        G = [[share * value for value in row] for row in more]
        assert is_semidefinite(plus(more, G, Fraction(-1)))
        assert is_semidefinite(plus(inverse(start), inverse(plus(start, G)), Fraction(-1)))
    grown = [[Fraction(11, 10) * value for value in row] for row in more]
    assert not is_semidefinite(plus(more, grown, Fraction(-1)))


def flat(value: Any) -> np.ndarray:
    return np.asarray(ca.evalf(ca.SX(value)).full().ravel())


def steps_of(size: int, *, box: bool = True) -> tuple[LeastSquaresSteps, list[Any]]:
    """Two outputs of so many parameters, with symbols for all."""
    parts = (size, size - 1)
    total, outputs = sum(parts), len(parts)
    sizes = {"theta": total, "G": packed_size(parts), "true": total, "gain": total, "floor": 1, "retention": 1}
    symbols = {name: ca.SX.sym(name, count) for name, count in sizes.items()}
    h, y, ends = ca.SX.sym("h", total), ca.SX.sym("y", outputs), ca.SX.sym("ends", total, 2)
    named = [symbols[name] for name in ("theta", "G", "true", "gain")]
    own = (parts, symbols["floor"], symbols["retention"], ((h, y),), tuple(ca.horzsplit(ends)) if box else ())
    return LeastSquaresSteps("theta", "G", *named, *own), [*symbols.values(), h, y, ends]


def test_the_term_states_the_same_exactly_at_random_symmetric_memories() -> None:
    steps, symbols = steps_of(3, box=False)
    claim = ca.Function("claim", symbols, [steps.change + steps.decrease - steps.residual, steps.change])
    rng = random.Random(2)
    for _ in range(3):
        memories = [positive(rng, size) for size in steps.parts]
        triangles = [M[i][j] for M in memories for j in range(len(M)) for i in range(j, len(M))]
        given = [column(rng, 5), triangles, column(rng, 5), [abs(number(rng)) + 1 for _ in range(5)]]
        given += [[Fraction(1, 7)], [Fraction(9, 10)], column(rng, 5), column(rng, 2), column(rng, 10)]
        (left,), (change,) = evaluate(claim, given)
        assert left == 0
        assert change != 0


def test_steps_are_least_squares_of_all_rows() -> None:
    """With a wide box and without forgetting: the minimum over all rows and the distance from the start."""
    rng, steps, symbols = np.random.default_rng(3), *steps_of(3)
    after = ca.Function("after", symbols, [steps.held, steps.kept])
    parts, nu, gain = steps.parts, 0.2, rng.uniform(0.5, 2, 5)
    theta, start, G, ends = np.zeros(5), rng.normal(size=5), np.zeros(9), np.outer(np.ones(5), [-50, 50])
    theta, rows, values = start, rng.normal(size=(6, 5)), rng.normal(size=(6, 2))
    for h, y in zip(rows, values, strict=True):
        theta, G = after(theta, G, np.zeros(5), gain, nu, 1.0, h, y, ends)
    for j, part in enumerate((slice(0, 3), slice(3, 5))):
        weighed = np.vstack([rows[:, part] / np.sqrt(nu), np.diag(gain[part] ** -0.5)])
        wanted = np.concatenate([values[:, j] / np.sqrt(nu), gain[part] ** -0.5 * start[part]])
        best, *_ = np.linalg.lstsq(weighed, wanted, rcond=None)
        np.testing.assert_allclose(flat(theta)[part], best, atol=1e-10)
    for part, own in zip((slice(0, 3), slice(3, 5)), unpacked(parts, ca.DM(G)), strict=True):
        np.testing.assert_allclose(ca.evalf(own).full(), rows[:, part].T @ rows[:, part] / nu, atol=1e-10)


def test_after_a_step_the_estimate_is_in_its_box_and_no_farther_from_what_it_holds() -> None:
    rng, steps, symbols = np.random.default_rng(5), *steps_of(4)
    parts = (slice(0, 4), slice(4, 7))
    after = ca.Function("after", symbols, [steps.held, steps.kept, steps.storage.value, steps.residual])
    theta, true, gain, ends = np.zeros(7), rng.uniform(-1, 1, 7), rng.uniform(0.5, 2, 7), np.outer(np.ones(7), [-1, 1])
    G, before, dropped, met = np.zeros(packed_size(steps.parts)), np.inf, 0, 0
    for k in range(400):
        h = (1 + 0.3 * rng.normal(size=7)) * 3.0 ** rng.uniform(-3, 1)  # similar, so that one face leads out of another
        explained = np.array([h[part] @ true[part] for part in parts])
        eta = 3 * rng.normal(size=2) * (k % 2)
        was, y = G, explained + eta
        theta, G, V, gained = map(flat, after(theta, G, true, gain, 0.05, 0.95, h, y, ends))
        assert np.all(np.abs(theta) <= 1)
        assert V[0] <= before + 1e-9
        before = V[0] + gained[0]
        met += bool(np.any(np.abs(theta) == 1))
        empty = [not np.any(ca.evalf(own).full()) for own in unpacked(steps.parts, ca.DM(G))]
        dropped += k > 0 and any(empty) and not np.all(was == 0)
        for own in unpacked(steps.parts, ca.DM(G)):
            assert np.linalg.eigvalsh(ca.evalf(own).full())[0] >= -1e-9
    assert met > 20
    assert dropped > 0


def test_triangles_are_what_the_matrices_were() -> None:
    first, second = unpacked((3, 2), ca.DM([1, 2, 3, 4, 5, 6, 7, 8, 9]))
    np.testing.assert_array_equal(ca.evalf(first).full(), [[1, 2, 3], [2, 4, 5], [3, 5, 6]])
    np.testing.assert_array_equal(ca.evalf(second).full(), [[7, 8], [8, 9]])


class Cart(AbstractBlock):
    """m dv/dt + b v = c."""

    side = Side.PLANT
    inputs = (Input("c"),)
    outputs = (
        Output("y", access=Access.MEASURED),
        Output("v", access=Access.MEASURED),
        Output("m"),
        Output("b"),
        Output("force"),
    )
    states = (State("y"), State("v"))

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        outputs = {"y": x.y, "v": x.v, "m": 2.0, "b": 0.5, "force": u.c}
        return Equations(outputs=outputs, rates={"y": x.v, "v": (u.c - 0.5 * x.v) / 2.0})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        return Certificate()


class Learner(AbstractBlock):
    """Estimates m and b from c = m [v]/T + b [y]/T, by least squares or by a replacement."""

    inputs = (Input("y"), Input("v"), PERIOD)
    outputs = (Output("c", access=Access.COMMANDED),)
    states = (
        State("theta", "2", sampled=True),
        State("G", "3", sampled=True),
        State("y_old", sampled=True),
        State("v_old", sampled=True),
        State("c_old", sampled=True),
        State("count", sampled=True),
    )
    truth = (Input("m"), Input("b"), Input("force"))
    gain: Scalar = Positive(default=2.0)
    floor: Scalar = Positive(default=0.01)
    retention: Scalar = Positive(default=0.9)
    most: Scalar = Positive(default=10.0)
    lie: str = ""

    def _steps(self, u: Signals, x: Signals, p: Signals, true: Any) -> LeastSquaresSteps:
        h, one = ca.vertcat((u.v - x.v_old) / u.T, (u.y - x.y_old) / u.T), ca.DM.ones(2)
        own = (x.theta, x.G, true, p.gain * one, (2,), p.floor, p.retention, ((h, x.c_old),), (0 * one, p.most * one))
        return LeastSquaresSteps("theta", "G", *own)

    def _mutated(self, x: Signals, p: Signals, steps: LeastSquaresSteps) -> tuple[Any, Any]:
        """Theta and G of a false statement."""
        (h, y), theta, G = steps.rows[0], steps.held, steps.kept
        old = ca.DM.eye(2) / p.gain + ca.tril2symm(ca.SX(ca.Sparsity.lower(2), x.G))
        new, missed = old + h @ h.T / p.floor, y - ca.dot(h, x.theta)
        learnt = ca.inv(old) @ h
        size = p.floor + ca.dot(h, learnt)
        match self.lie:
            case "gain_after":
                theta = ca.fmin(ca.fmax(x.theta + ca.inv(new) @ h * missed / size, 0), p.most)
            case "clipped":
                theta = ca.fmin(ca.fmax(x.theta + learnt * missed / size, 0), p.most)
            case "sign":
                theta = 2 * x.theta - steps.held
            case "prior_forgotten":
                G = G - (1 - p.retention) * ca.vertcat(1, 0, 1) / p.gain
            case "remembers_less":
                G = 0.99 * G
            case "never_gathers":
                G = p.retention * x.G
        return theta, G

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        theta, G = self._mutated(x, p, self._steps(u, x, p, ca.DM.zeros(2)))
        pushes = ca.sin(3 * x.count) + ca.cos(2 * x.count)
        clock = {"y_old": u.y, "v_old": u.v, "c_old": pushes, "count": x.count + u.T}
        return Equations(outputs={"c": pushes}, next={"theta": theta, "G": G, **clock})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        steps = self._steps(u, x, p, ca.vertcat(truth.m, truth.b))
        match self.lie:
            case "one_state":
                steps = replace(steps, memory="theta", gathered=x.theta)
            case "unknown_state":
                steps = replace(steps, memory="H")
            case "short":
                steps = replace(steps, gathered=x.G[:2])
            case "elsewhere":
                steps = replace(steps, gathered=2 * x.G)
            case "moving":
                steps = replace(steps, retention=x.count)
            case "own_rows":
                steps = replace(steps, rows=((steps.rows[0][0] + x.G[0], steps.rows[0][1]),))
            case "two_factors":
                steps = replace(steps, retention=p.retention * ca.DM.ones(2))
            case "another_relation":
                return Certificate(steps=(steps,), plant=(PlantIdentity(ca.SX(u.y), -u.v),))
        return Certificate(steps=(steps,), plant=(PlantIdentity(truth.m * u.v, truth.b * u.v - truth.force),))


def verdict(start: dict[str, Any] | None = None, **options: Any) -> Verdict:
    return verify(Diagram.build({"learner": Learner(**options), "cart": Cart()}), start=start)


def test_an_estimator_by_least_squares_is_proved_over_samples() -> None:
    found = verdict()
    assert found.outcome == "proved", found.reason
    assert all(control.refuted for control in found.controls)
    assert {control.fault for control in found.controls} >= {
        "learner.theta: increment reversed",
        "learner.G: increment reversed",
        "learner.retention changed in the equations only",
        "learner.floor changed in the equations only",
        "learner.gain changed in the equations only",
        "learner.most changed in the equations only",
    }
    assert "learner: retention of the steps of theta" in [item.name for item in found.conditions]
    assert not any("divide" in item.text for item in found.assumptions)
    assert "plus eta^2 over the floor" in "\n".join(item.step for item in found.statements)


@pytest.mark.parametrize(
    ("lie", "state"),
    [
        ("gain_after", "theta"),
        ("clipped", "theta"),
        ("sign", "theta"),
        ("prior_forgotten", "G"),
        ("remembers_less", "G"),
        ("never_gathers", "G"),
    ],
)
def test_another_law_is_refuted(lie: str, state: str) -> None:
    found = verdict(lie=lie)
    assert found.refutation is not None, found.reason
    assert found.refutation.statement == f"learner: next value of {state}"


@pytest.mark.parametrize(
    ("lie", "reports"),
    [
        ("one_state", "expected their memory to be a state of its own, found theta"),
        ("unknown_state", "names H, which is not one of its sampled states"),
        ("short", "expected lower triangles of 3 x 1, found 2 x 1"),
        ("elsewhere", "start for G from another value than that state"),
        ("moving", "the retention of the steps of theta varies"),
        ("own_rows", "the rows of theta contain G itself"),
        ("two_factors", "expected one retention, found 2 x 1"),
    ],
)
def test_a_claim_of_another_form_is_none(lie: str, reports: str) -> None:
    found = verdict(lie=lie)
    assert found.outcome == "not_applicable"
    assert reports in found.reason


@pytest.mark.parametrize(
    ("start", "holds"),
    [([0, 0, 0], True), ([2, 1, 3], True), ([1, 1, 1], True), ([1, 2, 1], False), ([-1e-9, 0, 0], False)],
)
def test_a_memory_starts_positive_semidefinite(start: list[float], holds: bool) -> None:
    found = verdict({"learner.G": start})
    assert (found.outcome == "proved") is holds
    assert ("learner: start of G" in found.reason) is not holds


def test_a_memory_that_grows_by_itself_and_a_box_without_the_truth_are_reported() -> None:
    assert "retention of the steps of theta" in verdict(retention=1.01).reason
    assert "true value of theta inside its box" in verdict(most=1.5).reason


@pytest.mark.parametrize("lie", ["", "another_relation"])
def test_rows_are_compared_with_the_plants_motion_whatever_relation_is_stated(lie: str) -> None:
    """dy/dt = v is true for the plant, and independent of its mass."""
    found = verdict(lie=lie)
    assert found.outcome == "proved"
    assert not found.rows_assumed
    (item,) = [item for item in found.conditions if "falls with the period" in item.name]
    assert item.holds
    assert item.how == "sampled"


def test_along_a_run_v_falls_and_the_true_values_are_found() -> None:
    built = Diagram.build({"learner": Learner(retention=0.99), "cart": Cart()})
    run = simulate(built, 20.0, clock=0.05, engine="interpreted")
    error, G = run.states["learner.theta"] - np.array([2.0, 0.5]), run.states["learner.G"]
    W = np.array([[[1 / 2 + a, b], [b, 1 / 2 + c]] for a, b, c in G])
    V = np.einsum("ki,kij,kj->k", error, W, error)
    assert np.all(np.diff(V) < 1e-9)  # over a sample the identity is exact
    assert np.max(np.abs(error[-1])) < 1e-3
