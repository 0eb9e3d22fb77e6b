"""Symmetric positive definite gains: an exact test, and gains from a prior of the parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import lcm
from typing import final

Rows = tuple[tuple[float, ...], ...]


@final
@dataclass(frozen=True)
class Prior:
    """Gain from a prior of the parameters, ``{inverse_of: model, scale: 0.1}``.

    Parameters
    ----------
    inverse_of
        Block whose `AbstractBlock.prior` is the expected size of the parameters' errors.
    scale
        Factor of the gain.
    others
        Expected size of parameters without a prior, such as friction, in the parameter's unit.
    """

    inverse_of: str
    scale: float = 1.0
    others: float = 1.0


def check_definite(rows: Rows) -> None:
    """Raise `ValueError` if a matrix is not square, symmetric and positive definite; exact in its decimals."""
    n = len(rows)
    if any(len(row) != n for row in rows):
        raise ValueError(f"expected a square matrix, found {n} x {len(rows[0])}")
    for i in range(n):
        for j in range(i):
            if rows[i][j] != rows[j][i]:
                raise ValueError(
                    f"expected a symmetric matrix, found {rows[i][j]:.17g} at [{i}, {j}] and {rows[j][i]:.17g} at "
                    f"[{j}, {i}]"
                )
    at, pivot = _last_pivot(rows)
    if pivot <= 0:
        raise ValueError(f"expected a positive definite matrix, found the pivot {float(pivot):.4g} at [{at}, {at}]")


def _last_pivot(rows: Sequence[Sequence[float]]) -> tuple[int, Fraction]:
    """First pivot of LDL' that is not positive, with its index; the last one if all are positive.

    By Bareiss's algorithm: its integers are the minors, whose ratios are the pivots, without reduction of fractions.
    """
    exact = [[Fraction(repr(float(value))) for value in row] for row in rows]
    unit = lcm(*(value.denominator for row in exact for value in row))
    left, before = [[int(value * unit) for value in row] for row in exact], 1
    for k, row in enumerate(left):
        pivot = Fraction(row[k], before * unit)
        if pivot <= 0 or k == len(left) - 1:
            break
        for i in range(k + 1, len(left)):
            for j in range(k + 1, i + 1):
                left[i][j] = (left[i][j] * row[k] - left[i][k] * left[j][k]) // before
        before = row[k]
    return k, pivot
