"""Gains that are symmetric positive definite matrices: what may be written for one, and an exact test of it."""

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
    """A gain that a model of the parameters gives, ``{inverse_of: model, scale: 0.1}``.

    Parameters
    ----------
    inverse_of
        The block whose `AbstractBlock.prior` says how large the errors of its parameters may be.
    scale
        The factor of the whole gain.
    others
        How large a parameter is about which that block knows nothing, such as a friction: in the parameter's own unit.
    """

    inverse_of: str
    scale: float = 1.0
    others: float = 1.0


def check_definite(rows: Rows) -> None:
    """Raise `ValueError` where a matrix is not square, symmetric and positive definite, decided in its decimals."""
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
    """The first diagonal element of LDL' that is not positive, with its place; the last one where all are positive.

    By Bareiss: its integers are the minors, and a pivot is the ratio of two of them, so that no fraction is reduced.
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


__all__ = ["Prior", "Rows", "check_definite"]
