"""Definiteness and semidefiniteness of symmetric matrices of numbers or intervals, in rational arithmetic."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import gcd, lcm
from typing import Any

from dmframe.exact.rational import Interval

Number = Fraction | Interval


def pivots(matrix: Sequence[Sequence[Number]]) -> list[Fraction]:
    """Exact diagonal of LDL' up to the first pivot that is not positive; of an interval, its lower end."""
    if not any(isinstance(value, Interval) for row in matrix for value in row):
        return _integer_pivots(matrix)
    rows = [[Interval.of(value) for value in row] for row in matrix]
    found = list[Fraction]()
    for j in range(len(rows)):
        pivot = rows[j][j]
        found.append(pivot.lower)
        if found[-1] <= 0:
            break
        for i in range(j + 1, len(rows)):
            factor = rows[i][j] / pivot
            rows[i] = [above - factor * below for above, below in zip(rows[i], rows[j], strict=True)]
    return found


def _integer_pivots(matrix: Sequence[Sequence[Any]]) -> list[Fraction]:
    """Pivots of a rational matrix by integer arithmetic: each row is a multiple of the true row.

    Common factors of a row are divided out, so that the integers stay as short as those of Fractions, at a tenth of the
    time. A row with a zero in the pivot column is not changed.
    """
    scales = [Fraction(lcm(*(Fraction(value).denominator for value in row))) for row in matrix]
    rows = [[int(value * scale) for value in row] for row, scale in zip(matrix, scales, strict=True)]
    found = list[Fraction]()
    for j, row in enumerate(rows):
        pivot = row[j]
        found.append(pivot / scales[j])
        if pivot <= 0:
            break
        for i in range(j + 1, len(rows)):
            if across := rows[i][j]:
                common = gcd(pivot, across)
                own, other = pivot // common, across // common
                left = [own * above - other * below for above, below in zip(rows[i], row, strict=True)]
                common = gcd(*left) or 1
                rows[i] = [value // common for value in left] if common > 1 else left
                scales[i] *= Fraction(own, common)
    return found


def lower(value: Number) -> Fraction:
    """Lower bound of a number."""
    return value.lower if isinstance(value, Interval) else value


def upper(value: Number) -> Fraction:
    """Upper bound of a number."""
    return value.upper if isinstance(value, Interval) else value


def is_semidefinite(matrix: Sequence[Sequence[Fraction]]) -> bool:
    """True if the quadratic form of a symmetric matrix is nonnegative in every direction, decided exactly."""
    rows = [list(row) for row in matrix]
    while rows:
        pivot, across = rows[0][0], rows[0][1:]
        if pivot < 0 or (pivot == 0 and any(across)):
            return False
        rows = [
            [value - (left * above / pivot if pivot else 0) for value, above in zip(row[1:], across, strict=True)]
            for row, left in zip(rows[1:], across, strict=True)
        ]
    return True
