"""Unrolled eigenvalues compared with NumPy's, for matrices of all kinds."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import casadi as ca
import numpy as np
import pytest

import dmframe.common.eigen as module
from dmframe.common.eigen import eigen, positive_part

KINDS = {
    "any": lambda rng: rng.normal(size=4),
    "graded": lambda rng: 10.0 ** rng.uniform(-8, 8, 4) * rng.choice([-1, 1], 4),
    "clustered": lambda rng: 1 + 1e-9 * rng.normal(size=4),
    "half null": lambda rng: np.array([1, 1, 0, 0]) + 1e-14 * rng.normal(size=4),
    "one of four": lambda rng: np.array([1.0, 1, 1, -1]),
    "whole numbers": lambda rng: rng.integers(-2, 3, 4).astype(float),
}


def matrices(count: int) -> Iterator[np.ndarray]:
    rng = np.random.default_rng(0)
    yield np.zeros((4, 4))
    yield np.eye(4)
    yield np.ones((4, 4))
    for k in range(count):
        turned, _ = np.linalg.qr(rng.normal(size=(4, 4)))
        A = turned * list(KINDS.values())[k % len(KINDS)](rng) @ turned.T
        if k % 7 == 0:
            A = rng.integers(-2, 3, (4, 4)).astype(float)  # with equal elements on the diagonal
        yield (A + A.T) / 2


def functions() -> Any:
    A = ca.SX.sym("A", 4, 4)
    return ca.Function("eigen", [A], [*eigen(A), positive_part(A)])


def worst(count: int = 1200) -> float:
    """Distance of values, vectors and the positive part from NumPy's, relative to the matrix."""
    function, found = functions(), 0.0
    for A in matrices(count):
        values, V, positive = (item.full() for item in function(A))
        exact, U = np.linalg.eigh(A)
        size = max(np.linalg.norm(A), 1e-300)
        found = max(
            found,
            float(np.abs(np.sort(values.ravel()) - exact).max() / size),
            float(np.abs(positive - U * np.maximum(exact, 0) @ U.T).max() / size),
            float(np.abs(V.T @ V - np.eye(4)).max()),
            float(np.abs(V * values.ravel() @ V.T - A).max() / size),
        )
    return found


def test_values_vectors_and_the_positive_part_are_those_of_numpy() -> None:
    assert worst() < 1e-14


def test_one_sweep_less_would_not_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SWEEPS", 4)
    module._unrolled.cache_clear()
    try:
        assert worst() > 1e-12
    finally:
        module._unrolled.cache_clear()


def test_the_positive_part_has_a_derivative_where_all_eigenvalues_are_the_same() -> None:
    A = ca.SX.sym("A", 4, 4)
    slope = ca.Function("slope", [A], [ca.jacobian(ca.vec(positive_part(-A)), ca.vec(A))])
    np.testing.assert_array_equal(slope(np.eye(4)).full(), 0)
