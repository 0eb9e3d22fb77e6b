r"""Matrices of enclosures: middles with radii, the exponential of a held system, and definiteness.

All numbers are Python integers in units of 2^-256, so that stiff systems lose no digits that would matter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from dmframe.exact.fixed import ONE, PLACES, Fixed, UndecidedError

Integers = NDArray[Any]

_MOST_DOUBLINGS: Final = 60


@final
class Matrix:
    """All matrices whose elements lie within `radius` of `middle`."""

    __slots__ = ("middle", "radius")

    def __init__(self, middle: Integers, radius: Integers) -> None:
        self.middle, self.radius = middle, radius

    @staticmethod
    def of(elements: Sequence[Sequence[Fixed]], columns: int) -> Matrix:
        """Rows of enclosures."""
        middle, radius = _zeros(len(elements), columns), _zeros(len(elements), columns)
        for i, row in enumerate(elements):
            for j, value in enumerate(row):
                middle[i, j] = value.middle
                radius[i, j] = value.upper - value.middle
        return Matrix(middle, radius)

    @staticmethod
    def exactly(numbers: Any) -> Matrix:
        """Floats, taken as the binary numbers that they are."""
        given = np.asarray(numbers, dtype=float)
        middle = _zeros(*given.shape)
        for place, value in np.ndenumerate(given):
            above, below = float(value).as_integer_ratio()
            middle[place] = (above << PLACES) // below
        return Matrix(middle, _zeros(*given.shape))

    @staticmethod
    def identity(size: int) -> Matrix:
        """Ones on the diagonal."""
        return Matrix.exactly(np.eye(size))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.middle.shape
        return rows, columns

    @property
    def T(self) -> Matrix:
        """The transpose."""
        return Matrix(self.middle.T, self.radius.T)

    def __getitem__(self, place: Any) -> Matrix:
        return Matrix(self.middle[place], self.radius[place])

    def __add__(self, other: Matrix) -> Matrix:
        return Matrix(self.middle + other.middle, self.radius + other.radius)

    def __sub__(self, other: Matrix) -> Matrix:
        return Matrix(self.middle - other.middle, self.radius + other.radius)

    def __matmul__(self, other: Matrix) -> Matrix:
        middle = (self.middle @ other.middle) >> PLACES
        spread = np.abs(self.middle) @ other.radius + self.radius @ (np.abs(other.middle) + other.radius)
        return Matrix(middle, (spread >> PLACES) + 2)  # one for each of two roundings

    def times(self, factor: Fixed) -> Matrix:
        """Every element times a number."""
        middle, reach = factor.middle, factor.upper - factor.middle
        spread = np.abs(self.middle) * reach + self.radius * (abs(middle) + reach)
        return Matrix((self.middle * middle) >> PLACES, (spread >> PLACES) + 2)

    def scaled(self, rows: Sequence[int], columns: Sequence[int]) -> Matrix:
        """Row i times 2^rows[i], column j times 2^columns[j]."""
        middle, radius = self.middle.copy(), self.radius.copy()
        for (i, j), value in np.ndenumerate(self.middle):
            shift = rows[i] + columns[j]
            if shift >= 0:
                middle[i, j], radius[i, j] = value << shift, radius[i, j] << shift
            else:
                middle[i, j], radius[i, j] = value >> -shift, (radius[i, j] >> -shift) + 2
        return Matrix(middle, radius)

    def floats(self) -> NDArray[np.float64]:
        """The middles; infinite where they are too large."""
        return in_floats(self.middle)

    @property
    def row_sum(self) -> int:
        """At least the largest sum of absolute values in a row."""
        return max((int(value) for value in np.sum(np.abs(self.middle) + self.radius, axis=1)), default=0)

    def positive_definite(self) -> bool:
        """True where every symmetric matrix in the enclosure is: L D L' with every element of D above zero."""
        left = self
        for _ in range(self.shape[0]):
            pivot = Fixed(left.middle[0, 0] - left.radius[0, 0], left.middle[0, 0] + left.radius[0, 0])
            if pivot.lower <= 0:
                return False
            column = left[1:, :1]
            left = left[1:, 1:] - (column @ column.T).times(1 / pivot)
        return True


def held(A: Matrix, time: Fixed) -> tuple[Matrix, Matrix]:
    r"""The transition of dx/dt = A x + b over a time, b held: :math:`e^{At}` and :math:`\int_0^t e^{As} ds`.

    The series of a 2^k-th of the time, with all that is left out, doubled k times.
    """
    size, one = A.shape[0], Matrix.identity(A.shape[0])
    whole = A.times(time)
    doublings = max(0, whole.row_sum.bit_length() - PLACES + 1)
    if doublings > _MOST_DOUBLINGS:
        raise UndecidedError("the plant's rates are too fast for this clock")
    part = Fixed(time.lower >> doublings, -(-time.upper >> doublings))
    X = A.times(part)  # of norm at most one half
    total, term, k = one, one, 1
    while term.row_sum > 1 + 8 * size:  # each is at most half of the one before, but for the rounding
        k += 1
        term = (term @ X).times(Fixed.around(1.0) / Fixed(k << PLACES, k << PLACES))
        total = total + term
        if k > 2 * PLACES:
            raise UndecidedError("the plant's transition cannot be enclosed")
    left_out = _zeros(size, size) + 2 * term.row_sum
    integral = Matrix(total.middle, total.radius + left_out).times(part)
    transition = one + A @ integral
    for _ in range(doublings):
        integral = integral + transition @ integral
        transition = transition @ transition
    return transition, integral


def in_floats(numbers: Integers) -> NDArray[np.float64]:
    """Numbers in units of 2^-256, each rounded to the nearest float; infinite where it is too large for one."""
    found = np.zeros(numbers.shape)
    for place, value in np.ndenumerate(numbers):
        try:
            found[place] = value / ONE
        except OverflowError:
            found[place] = math.inf if value > 0 else -math.inf
    return found


def _zeros(rows: int, columns: int) -> Integers:
    found = np.empty((rows, columns), dtype=object)
    found[:] = 0
    return found
