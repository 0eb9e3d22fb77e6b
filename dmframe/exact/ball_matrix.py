"""Ball matrices: conversion from and to floats, positive definiteness, and transition under zero-order hold."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from flint import arb, arb_mat
from numpy.typing import NDArray

from dmframe.exact.balls import ONE, ZERO, UndecidedError, above, precise


def exactly(numbers: Any) -> arb_mat:
    """Ball matrix of the exact binary values of floats."""
    given = np.asarray(numbers, dtype=float)
    rows, columns = given.shape
    return arb_mat(rows, columns, given.ravel().tolist())


def identity(size: int) -> arb_mat:
    """Identity matrix."""
    return exactly(np.eye(size))


def middles(matrix: arb_mat) -> NDArray[np.float64]:
    """The midpoints as floats; infinite on overflow."""
    return _floats(matrix, float)


def radii(matrix: arb_mat) -> NDArray[np.float64]:
    """The radii as floats, rounded up."""
    return _floats(matrix, lambda value: above(value.rad()))


def _floats(matrix: arb_mat, of: Any) -> NDArray[np.float64]:
    return np.array([of(value) for value in matrix.entries()], dtype=float).reshape(matrix.nrows(), matrix.ncols())


@precise()
def scaled(matrix: arb_mat, rows: Sequence[int], columns: Sequence[int]) -> arb_mat:
    """The matrix with row i scaled by 2^rows[i] and column j by 2^columns[j], without rounding."""
    return arb_mat([
        [value * arb((1, i + j)) for value, j in zip(row, columns, strict=True)]
        for row, i in zip(matrix.tolist(), rows, strict=True)
    ])  # fmt: skip


@precise()
def positive_definite(matrix: arb_mat) -> bool:
    """True if every symmetric matrix in the enclosure is positive definite: L D L' with every element of D positive."""
    left = matrix.tolist()
    for k, row in enumerate(left):
        pivot = row[k]
        if not pivot > 0:
            return False
        column = [below_it[k] for below_it in left]
        for i in range(k + 1, len(left)):
            factor = column[i] / pivot
            for j in range(k + 1, i + 1):
                left[i][j] -= factor * column[j]
    return True


@precise()
def transition(A: arb_mat, time: arb) -> tuple[arb_mat, arb_mat]:
    r"""Transition matrices of dx/dt = A x + b with constant b: :math:`e^{At}` and :math:`\int_0^t e^{As} ds`.

    Both are blocks of one matrix exponential [VanLoan1978]_:

    .. math:: \exp \begin{bmatrix} A t & t \\ 0 & 0 \end{bmatrix} =
        \begin{bmatrix} e^{At} & \int_0^t e^{As} ds \\ 0 & 1 \end{bmatrix}

    Raises `UndecidedError` if the enclosure is not finite.
    """
    size = A.nrows()
    rows = [[*row, *(ONE if i == j else ZERO for j in range(size))] for i, row in enumerate(A.tolist())]
    both = (arb_mat([*rows, *([ZERO] * (2 * size) for _ in range(size))]) * time).exp().tolist()
    if not all(value.is_finite() for row in both[:size] for value in row):
        raise UndecidedError("the plant's fastest mode is too fast for this sampling period")
    return arb_mat([row[:size] for row in both[:size]]), arb_mat([row[size:] for row in both[:size]])


__all__ = ["exactly", "identity", "middles", "positive_definite", "radii", "scaled", "transition"]
