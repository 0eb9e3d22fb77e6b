"""The set of bodies: nearest points, tangent cones and the projection lemma, compared with NumPy and SciPy."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy

from dmframe.diagram.projection import Bodies
from dmframe.robot.pseudo_inertia import parameters_of, pseudo_inertia

SHARE = 0.2


def column(values: Any) -> Any:
    return ca.SX(ca.DM(np.asarray(values, dtype=float)))


def numbers(expression: Any) -> np.ndarray:
    return np.array(ca.DM(ca.evalf(ca.densify(expression)))).ravel()


def functions() -> Any:
    """`held`, `law` and `room` of one link, as functions of its nominal body, estimates and their rate."""
    nominal, state, rate = (ca.SX.sym(name, 10) for name in ("nominal", "state", "rate"))
    bodies = Bodies(nominal, ca.SX(SHARE))
    outputs = [bodies.held(state), bodies.law(state, rate), bodies.room(state)]
    return ca.Function("set", [nominal, state, rate], outputs)


FUNCTIONS = functions()


def held_law_room(P0: np.ndarray, a: np.ndarray, rate: np.ndarray | None = None) -> list[np.ndarray]:
    return [item.full().ravel() for item in FUNCTIONS(row(P0), a, np.zeros(10) if rate is None else rate)]


def nearest(P0: np.ndarray, a: np.ndarray) -> np.ndarray:
    return held_law_room(P0, a)[0]


def matrix(a: np.ndarray) -> np.ndarray:
    return np.array(pseudo_inertia(list(a)), dtype=float)


def row(P: np.ndarray) -> np.ndarray:
    return np.array(parameters_of(P.tolist()), dtype=float)


def symmetric(rng: np.random.Generator) -> np.ndarray:
    X = rng.normal(size=(4, 4))
    return np.asarray((X + X.T) / 2)


def body(rng: np.random.Generator) -> np.ndarray:
    """A pseudo-inertia with a typical range of eigenvalues."""
    turned, _ = np.linalg.qr(rng.normal(size=(4, 4)))
    return np.asarray(turned * [0.02, 0.1, 0.5, 8] @ turned.T)


def distance(a: np.ndarray, b: np.ndarray, P0: np.ndarray) -> float:
    """trace(P0^-1 X P0^-1 X), X the difference of the pseudo-inertias."""
    X = np.linalg.solve(P0, matrix(a - b))
    return float(np.trace(X @ X))


def least(a: np.ndarray, P0: np.ndarray) -> float:
    """The least eigenvalue of P0^-1 P(a)."""
    return float(np.linalg.eigvals(np.linalg.solve(P0, matrix(a))).real.min())


def outside(rng: np.random.Generator, P0: np.ndarray) -> np.ndarray:
    root = np.linalg.cholesky(P0)
    return row(root @ (symmetric(rng) * 2 + 0.3 * np.eye(4)) @ root.T)


def inside(rng: np.random.Generator, P0: np.ndarray) -> np.ndarray:
    """With one to four eigenvalues above the share, the others at it."""
    X, root = rng.normal(size=(4, rng.integers(1, 5))), np.linalg.cholesky(P0)
    return row(root @ (X @ X.T + SHARE * np.eye(4)) @ root.T)


def test_the_nearest_body_is_the_one_that_numpy_clips_and_no_other_is_nearer() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        P0 = body(rng)
        a = outside(rng, P0)
        held, root = nearest(P0, a), np.linalg.cholesky(P0)
        Z = np.linalg.solve(root, np.linalg.solve(root, matrix(a)).T)
        values, V = np.linalg.eigh((Z + Z.T) / 2)
        np.testing.assert_allclose(matrix(held), root @ (V * np.maximum(values, SHARE) @ V.T) @ root.T, atol=1e-12)
        assert least(held, P0) > SHARE - 1e-12
        for _ in range(20):
            assert distance(held, a, P0) <= distance(inside(rng, P0), a, P0)


def test_the_nearest_body_is_where_scipy_ends() -> None:
    rng = np.random.default_rng(1)
    for _ in range(3):
        P0 = body(rng)
        a, root = outside(rng, P0), np.linalg.cholesky(P0)
        held = nearest(P0, a)

        def made(y: np.ndarray, root: np.ndarray = root) -> np.ndarray:
            Y = y.reshape(4, 4)
            return row(root @ (Y @ Y.T + SHARE * np.eye(4)) @ root.T)

        found = scipy.optimize.minimize(
            lambda y, a=a, P0=P0: distance(made(y), a, P0), np.eye(4).ravel(), method="BFGS"
        )
        assert distance(held, a, P0) == pytest.approx(found.fun, rel=1e-4)
        assert distance(held, made(found.x), P0) < 1e-4 * distance(held, a, P0)


def test_inside_nothing_moves_and_what_belongs_to_no_body_never_does() -> None:
    rng = np.random.default_rng(2)
    first, second = body(rng), body(rng)
    bodies = Bodies(column([*row(first), *row(second)]), column(SHARE))
    a = np.array([*row(0.21 * first), *row(3 * second), 7.0, -9.0])
    np.testing.assert_array_equal(numbers(bodies.held(column(a))), a)
    a[10:20] = row(0.1 * second)
    held = numbers(bodies.held(column(a)))
    np.testing.assert_array_equal(held[:10], a[:10])
    np.testing.assert_allclose(held[10:20], row(SHARE * second), atol=1e-12)
    np.testing.assert_array_equal(held[20:], a[20:])
    assert not numbers(bodies.law(column(a), column(rng.normal(size=22))))[20:].any()


def test_v_never_rises_at_a_clip_whatever_the_true_body_in_the_set() -> None:
    rng = np.random.default_rng(3)
    fell = 0
    for _ in range(200):
        P0 = body(rng)
        a, truth = outside(rng, P0), inside(rng, P0)
        before, held = distance(a, truth, P0), nearest(P0, a)
        assert distance(held, truth, P0) <= before * (1 + 1e-12)
        fell += distance(held, truth, P0) < 0.9 * before
    assert fell > 100


def test_a_true_body_outside_the_set_allows_a_clip_to_raise_v() -> None:
    rng = np.random.default_rng(4)
    P0 = body(rng)
    truth = row(0.05 * P0)  # below the share
    held = nearest(P0, truth)
    assert distance(held, truth, P0) > 0


def test_on_the_rim_the_rate_that_is_left_is_the_nearest_that_does_not_lead_out() -> None:
    rng = np.random.default_rng(5)
    stopped = 0
    for k in range(40):
        P0 = body(rng)
        root, rim = np.linalg.cholesky(P0), 1 + k % 3
        turned, _ = np.linalg.qr(rng.normal(size=(4, 4)))
        values = np.array([*np.full(rim, SHARE - 1e-12), *rng.uniform(0.3, 2, 4 - rim)])
        a, rate, truth = row(root @ (turned * values @ turned.T) @ root.T), outside(rng, P0), inside(rng, P0)
        correction = held_law_room(P0, a, rate)[1]
        seen = np.linalg.solve(root, np.linalg.solve(root, matrix(rate)).T)
        D = turned[:, :rim].T @ seen @ turned[:, :rim]
        out, U = np.linalg.eigh((D + D.T) / 2)
        taken = root @ turned[:, :rim] @ (U * np.maximum(-out, 0) @ U.T) @ turned[:, :rim].T @ root.T
        np.testing.assert_allclose(matrix(correction), taken, atol=1e-9)
        X, C = np.linalg.solve(P0, matrix(a - truth)), np.linalg.solve(P0, matrix(correction))
        assert np.trace(X @ C) <= 1e-9
        ahead = nearest(P0, a + 1e-6 * rate) - a  # what a step and a clip leave of it
        np.testing.assert_allclose(ahead / 1e-6, rate + correction, atol=2e-4 * np.abs(rate).max())
        stopped += bool(np.abs(correction).max() > 1e-6)
    assert stopped > 20


def test_there_is_room_where_no_eigenvalue_is_below_the_share() -> None:
    rng = np.random.default_rng(6)
    sides = set()
    for _ in range(200):
        P0 = body(rng)
        a = outside(rng, P0) if rng.uniform() < 0.5 else inside(rng, P0) * 1.001
        room = held_law_room(P0, a)[2]
        within = least(a, P0) > SHARE
        assert within == bool((room > 0).all())
        sides.add(within)
    assert sides == {True, False}


def test_it_is_normal_in_the_metric_of_the_nominal_bodies_alone() -> None:
    rng = np.random.default_rng(7)
    first, second = body(rng), body(rng)
    bodies = Bodies(column([*row(first), *row(second)]), column(SHARE))

    def metric(P0: np.ndarray) -> np.ndarray:
        X = np.linalg.inv(P0)
        units = [matrix(unit) for unit in np.eye(10)]
        return np.array([[np.trace(X @ B @ X @ D) for D in units] for B in units])

    W = np.zeros((21, 21))
    W[:10, :10], W[10:20, 10:20], W[20, 20] = 3 * metric(first), metric(second), 5

    def askew(weight: np.ndarray) -> float:
        return float(np.abs(numbers(bodies.askew(column(weight)))).max())

    assert askew(W) < 1e-6
    for wrong in (W + 0.1 * np.eye(21), np.ones((21, 21)) * 0.1 + W, np.linalg.inv(W)):
        assert askew(wrong) > 1e-2
    assert askew(np.ones(21)) > 1e-2
