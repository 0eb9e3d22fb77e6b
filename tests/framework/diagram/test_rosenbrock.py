"""The linearly implicit method: its order conditions, its linear systems, and its approximate Jacobian."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from dmframe.common.errors import EngineError
from dmframe.diagram.elimination import MOST_FACTORS, Elimination, residual_small
from dmframe.diagram.rosenbrock import ROS34PW2, Rosenbrock
from dmframe.diagram.slopes import Slopes
from dmframe.graph.graph import Graph
from dmframe.robot.chain import pin_configuration
from dmframe.simulate import Log, Solver
from dmframe.simulate.run import prepare

PRINTED = Fraction(1, 10**15)
"""The coefficients were published to 16 digits."""


def residuals(method: Rosenbrock) -> Iterator[Fraction]:
    """Order conditions up to 3 for any A and d, Hairer and Wanner, section IV.7, theorem 7.7."""
    stages, b = range(method.stages), method.weights
    zeros = [Fraction(0)] * method.stages
    alpha = [[*row, *zeros[i:]] for i, row in enumerate(method.points)]
    gamma = [[*row, method.gamma, *zeros[i + 1 :]] for i, row in enumerate(method.couplings)]
    a, g = [sum(row) for row in alpha], [sum(row) for row in gamma]

    def tree(rows: list[list[Fraction]], leaves: list[Fraction]) -> Fraction:
        return sum((b[i] * rows[i][j] * leaves[j] for i in stages for j in stages), Fraction(0))

    yield sum(b) - 1
    yield sum(b[i] * a[i] for i in stages) - Fraction(1, 2)
    yield sum(b[i] * g[i] for i in stages)
    yield sum(b[i] * a[i] ** 2 for i in stages) - Fraction(1, 3)
    yield tree(alpha, a) - Fraction(1, 6)
    yield from (tree(alpha, g), tree(gamma, a), tree(gamma, g))


def largest(values: Iterator[Fraction]) -> Fraction:
    return max(map(abs, values))


def test_the_coefficients_meet_every_condition_of_third_order_for_any_matrix() -> None:
    assert largest(residuals(ROS34PW2)) < PRINTED


@pytest.mark.parametrize("stage", [1, 2, 3])
def test_a_coefficient_with_one_digit_changed_meets_them_no_more(stage: int) -> None:
    for name in ("points", "couplings"):
        rows = list(getattr(ROS34PW2, name))
        rows[stage] = (*rows[stage][:-1], rows[stage][-1] + Fraction(1, 10**6))
        assert largest(residuals(replace(ROS34PW2, **{name: tuple(rows)}))) > Fraction(1, 10**8)


def test_it_is_stiffly_accurate_and_stable_on_the_whole_left_half_plane() -> None:
    last = [a + g for a, g in zip((*ROS34PW2.points[-1], Fraction(0)), ROS34PW2.full[-1], strict=True)]
    assert largest(b - value for b, value in zip(ROS34PW2.weights, last, strict=True)) < PRINTED
    size, b = ROS34PW2.stages, np.array(ROS34PW2.weights, dtype=float)
    both = np.array([[float(value) for value in row] for row in ROS34PW2.full])
    for i, row in enumerate(ROS34PW2.points):
        both[i, :i] += [float(value) for value in row]

    def growth(z: complex) -> float:
        return float(abs(1 + z * b @ np.linalg.solve(np.eye(size) - z * both, np.ones(size))))

    assert max(growth(1j * y) for y in np.geomspace(1e-3, 1e6, 300)) <= 1 + 1e-12
    assert growth(-1e8) < 1e-7  # L-stable: an infinitely stiff component is zero after one step


def test_the_form_without_products_is_the_form_of_the_definition() -> None:
    size, rng = ROS34PW2.stages, np.random.default_rng(0)
    full = np.array([[float(value) for value in row] for row in ROS34PW2.full])
    k = rng.normal(size=size)
    u = full @ k
    for i in range(size):
        points = [float(value) for value in ROS34PW2.points[i]]
        assert np.dot([float(value) for value in ROS34PW2.a[i]], u[:i]) == pytest.approx(np.dot(points, k[:i]))
        coupled = sum(float(c) * value for c, value in zip(ROS34PW2.c[i], u[:i], strict=True))
        assert u[i] / float(ROS34PW2.gamma) - coupled == pytest.approx(k[i])
    assert np.dot([float(m) for m in ROS34PW2.m], u) == pytest.approx(np.dot([float(b) for b in ROS34PW2.weights], k))


def numbers(*expressions: Any) -> list[np.ndarray]:
    return [array.full() for array in ca.Function("f", [], list(expressions))().values()]


@pytest.mark.parametrize("seed", range(5))
def test_a_sparse_system_is_solved_as_lapack_solves_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = 12
    A = np.eye(size) + 0.4 * rng.normal(size=(size, size)) * (rng.random((size, size)) < 0.25)
    right = rng.normal(size=size)
    symbol = ca.SX.sym("A", ca.sparsify(ca.DM(A)).sparsity())
    elimination = Elimination.of(symbol)
    solution = ca.vertcat(*elimination.solution(elimination.factors, [ca.SX(value) for value in right]))
    f = ca.Function("f", [symbol], [solution, residual_small(symbol, solution, ca.SX(right))])
    found, small = f(A)
    np.testing.assert_allclose(found.full().ravel(), np.linalg.solve(A, right), rtol=1e-9)
    assert bool(small)


def test_the_pivots_fill_as_little_as_they_can() -> None:
    size = 9
    pattern = np.eye(size, dtype=bool)
    pattern[0, :] = pattern[:, 0] = True  # eliminated in this order, it fills in; from the other end it does not
    matrix = ca.SX.sym("A", ca.sparsify(ca.DM(pattern.astype(float))).sparsity())
    assert len(Elimination.of(matrix).factors) == 3 * size - 2


@pytest.mark.parametrize("pivot", [0.0, 1e-17, -1e-13])
def test_a_pivot_that_loses_the_digits_is_found_in_the_residual(pivot: float) -> None:
    A = np.array([[pivot, 1.0], [1.0, 0.3]])
    symbol, right = ca.SX.sym("A", 2, 2), ca.SX([1.0, 2.0])
    elimination = Elimination.of(symbol)
    solution = ca.vertcat(*elimination.solution(elimination.factors, ca.vertsplit(right)))
    f = ca.Function("f", [symbol], [solution, residual_small(symbol, solution, right)])
    found, small = (array.full().ravel() for array in f(A))
    sound = np.allclose(found, np.linalg.solve(A, [1, 2]), rtol=1e-6)
    assert bool(small[0]) is sound


def test_a_system_too_large_to_write_out_is_refused() -> None:
    size = int(MOST_FACTORS**0.5) + 2
    with pytest.raises(EngineError, match=r"solver: expected linear systems of at most 5000 factors, found more"):
        Elimination.of(ca.SX.sym("A", size, size))


def test_a_cheap_jacobian_is_used_whole_and_a_slow_one_without_inertia_gravity_and_coriolis_forces() -> None:
    small = prepare(Graph.read("arm2_joint").diagram, 1, clock=0.004, solver=Solver(), log=Log()).step.parts
    assert small.slopes.used is small.slopes.exact
    experiment = Graph.read("ur10_full")
    diagram = experiment.diagram
    parts = prepare(diagram, 1, clock=0.008, solver=Solver(), log=Log()).step.parts
    rng, n = np.random.default_rng(2), 6
    q, dq, q_c, i = rng.uniform(-1, 1, (4, n))
    dq[:2] *= 0.01  # where friction is steep
    values = {"arm.q": q, "arm.dq": dq, "servo.q_c": q_c, "servo.i": i}
    x = np.concatenate([values[variable.label] for variable in diagram.loop.flowing])
    places = {variable.label: slice(6 * k, 6 * k + 6) for k, variable in enumerate(diagram.loop.flowing)}
    u, w = rng.uniform(-1, 1, parts.rate.numel_in(1)), rng.uniform(-1, 1, parts.rate.numel_in(2))
    used, exact = (f(x, u, w, diagram.loop.p_values).full() for f in parts.slopes)
    chain = diagram.robot
    assert chain is not None
    model, configuration = chain.model, pin_configuration(chain, q)
    data = model.createData()
    M = np.triu(pin.crba(model, data, configuration))
    M += np.triu(M, 1).T
    pin.computeRNEADerivatives(model, data, configuration, dq, np.zeros(n))
    row, servo, arm = places["arm.dq"], diagram.blocks["servo"], diagram.blocks["arm"]
    left_out = (exact - used)[row]
    np.testing.assert_allclose(left_out[:, places["arm.dq"]], -np.linalg.solve(M, data.dtau_dv), rtol=1e-9, atol=1e-9)
    for name in ("servo.q_c", "servo.i"):
        np.testing.assert_array_equal(left_out[:, places[name]], 0)
    slope = np.cosh(dq / chain.friction_velocity) ** -2 / chain.friction_velocity
    damping = np.diag(np.asarray(arm.viscous) + np.asarray(arm.coulomb) * slope + np.asarray(servo.K_D))
    np.testing.assert_allclose(used[row, places["arm.dq"]], -np.linalg.solve(M, damping), rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(
        used[row, places["arm.q"]], -np.linalg.solve(M, np.diag(servo.K_P)), rtol=1e-9, atol=1e-8
    )


def test_a_slow_jacobian_leaves_out_what_is_in_a_square() -> None:
    x, u, w, p = ca.SX.sym("x", 30), ca.SX.sym("u", 0), ca.SX.sym("w", 0), ca.SX.sym("p")
    rate = -p * ca.sumsqr(x) * x - 3 * ca.tanh(x)
    slopes = Slopes.of(ca.Function("rate", [x, u, w, p], [rate]), 0)
    at = np.linspace(-1, 1, 30)
    used, exact = (f(at, [], [], 2.0).full() for f in slopes)
    np.testing.assert_allclose(used, np.diag(-3 * (1 - np.tanh(at) ** 2) - 2 * at @ at), atol=1e-12)
    np.testing.assert_allclose(exact, used - 4 * np.outer(at, at), atol=1e-12)
