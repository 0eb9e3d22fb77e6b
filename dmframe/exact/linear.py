"""Linear algebra over a prime field: ranks and null spaces without a threshold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import final

from dmframe.common.errors import ShapeError


class NoRationalError(ArithmeticError):
    """No fraction with small numerator and denominator has this residue."""


@final
class Echelon:
    """Reduced echelon form of a row space to which rows are added.

    Each row has 1 in its pivot column, 0 to the left of it and in all other pivot columns.
    """

    def __init__(self, prime: int, columns: int) -> None:
        self.prime = prime
        self.columns = columns
        self._rows: dict[int, list[int]] = {}

    @property
    def pivots(self) -> tuple[int, ...]:
        """Pivot columns, ascending: the first columns that are no combination of earlier ones."""
        return tuple(sorted(self._rows))

    @property
    def rows(self) -> list[list[int]]:
        """Reduced rows, in the order of their pivots."""
        return [list(self._rows[pivot]) for pivot in self.pivots]

    def add(self, row: Sequence[int]) -> bool:
        """Add a row; return whether the rank has increased. Raises `ShapeError` for a row of another length."""
        if len(row) != self.columns:
            raise ShapeError(f"row of an echelon form: expected {self.columns} elements, found {len(row)}")
        p = self.prime
        rest = [value % p for value in row]
        for pivot, kept in self._rows.items():
            if rest[pivot]:
                rest = _minus(rest, rest[pivot], kept, p)
        if not any(rest):
            return False
        pivot = next(column for column, value in enumerate(rest) if value)
        scale = pow(rest[pivot], -1, p)
        new = [value * scale % p for value in rest]
        for other, kept in self._rows.items():
            if kept[pivot]:
                self._rows[other] = _minus(kept, kept[pivot], new, p)
        self._rows[pivot] = new
        return True

    @property
    def undetermined(self) -> set[int]:
        """Columns in which some vector of the null space is nonzero."""
        determined = {pivot for pivot, row in self._rows.items() if sum(map(bool, row)) == 1}
        return set(range(self.columns)) - determined

    def null_space(self) -> list[list[int]]:
        """One vector for each column without a pivot: 1 there, 0 in the other columns without a pivot."""
        basis = []
        for free in sorted(set(range(self.columns)) - self._rows.keys()):
            vector = [0] * self.columns
            vector[free] = 1
            for pivot, row in self._rows.items():
                vector[pivot] = -row[free] % self.prime
            basis.append(vector)
        return basis


def _minus(row: Sequence[int], factor: int, other: Sequence[int], p: int) -> list[int]:
    return [(x - factor * y) % p if y else x for x, y in zip(row, other, strict=True)]


def reduced_echelon(rows: Sequence[Sequence[int]], prime: int) -> tuple[list[list[int]], tuple[int, ...]]:
    """Reduced row echelon form (its non-zero rows) and pivot columns."""
    echelon = Echelon(prime, len(rows[0]) if rows else 0)
    for row in rows:
        echelon.add(row)
    return echelon.rows, echelon.pivots


def rank(rows: Sequence[Sequence[int]], prime: int) -> int:
    """Rank over F_p, a lower bound on the rank of the rational matrix with these residues."""
    return len(reduced_echelon(rows, prime)[1])


def null_space(rows: Sequence[Sequence[int]], columns: int, prime: int) -> list[list[int]]:
    """Basis of the vectors x with A x = 0, where A has the rows `rows` of `columns` elements."""
    echelon = Echelon(prime, columns)
    for row in rows:
        echelon.add(row)
    return echelon.null_space()


def rational_reconstruction(residue: int, prime: int, bound: int | None = None) -> Fraction:
    """The fraction n/d = residue modulo `prime` with abs(n), d <= bound (sqrt(prime/2), which makes it unique).

    Half of the extended Euclidean algorithm, [Wang1981]_. Raises `NoRationalError` if there is none. A residue of a
    large fraction may equal that of a small one by chance: compare with a second prime.
    """
    limit = math.isqrt(prime // 2) if bound is None else bound
    remainder, previous = residue % prime, prime
    factor, previous_factor = 1, 0
    while remainder > limit:
        quotient = previous // remainder
        previous, remainder = remainder, previous - quotient * remainder
        previous_factor, factor = factor, previous_factor - quotient * factor
    if abs(factor) > limit or math.gcd(remainder, factor) != 1:
        raise NoRationalError(f"no fraction with parts up to {limit} has the residue {residue} modulo {prime}")
    return Fraction(remainder, factor)
