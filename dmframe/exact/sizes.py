"""Bounds on degrees and coefficients of the values of a program: the ring from which error bounds are derived."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Final, final

from dmframe.exact.ring import evaluated
from dmframe.exact.tape import Tape


@final
class Size:
    """Degrees of a numerator and a denominator, and log2 of the sum of their integer coefficients' absolute values."""

    __slots__ = ("degree", "denominator", "height", "height_denominator")

    def __init__(self, degree: int, denominator: int, height: int, height_denominator: int) -> None:
        self.degree, self.denominator = degree, denominator
        self.height, self.height_denominator = height, height_denominator

    def __add__(self, other: Size | int) -> Size:
        other = _sized(other)
        return Size(
            max(self.degree + other.denominator, other.degree + self.denominator),
            self.denominator + other.denominator,
            max(self.height + other.height_denominator, other.height + self.height_denominator) + 1,
            self.height_denominator + other.height_denominator,
        )

    def __mul__(self, other: Size | int) -> Size:
        other = _sized(other)
        return Size(
            self.degree + other.degree,
            self.denominator + other.denominator,
            self.height + other.height,
            self.height_denominator + other.height_denominator,
        )

    def __neg__(self) -> Size:
        return self

    __radd__, __sub__, __rsub__, __rmul__ = __add__, __add__, __add__, __mul__

    def power(self, exponent: int) -> Size:
        """An integer power."""
        n = abs(exponent)
        size = Size(n * self.degree, n * self.denominator, n * self.height, n * self.height_denominator)
        if exponent >= 0:
            return size
        return Size(size.denominator, size.degree, size.height_denominator, size.height)


def _sized(value: Size | int) -> Size:
    return value if isinstance(value, Size) else Size(0, 0, abs(value).bit_length(), 1)


_ONE: Final = Size(0, 0, 1, 1)
"""The number 1, with which a condition is compared."""


def free() -> Size:
    """A free symbol: always a new object, since the ring distinguishes values by identity."""
    return Size(1, 0, 0, 0)


@final
@dataclass(frozen=True)
class Bound:
    """Quantities that determine the probability of a wrong result.

    `degree` is the largest degree of the outputs' numerators, `height` log2 of the size of their integer coefficients.
    `degree_total` and `height_total` add the other failures at a random point: a vanishing denominator, and two
    different arguments of one function with equal values.
    """

    degree: int
    height: int
    degree_total: int
    height_total: int


@final
class Sizes:
    """The ring of sizes; it counts the polynomials that must not vanish at a random point.

    The free symbols are the inputs, one t for each point of the unit circle, and one symbol for each opaque value.
    """

    def __init__(self) -> None:
        self._inverses = dict[int, tuple[Size, Size]]()
        self._calls: dict[str, dict[tuple[int, ...], tuple[Size, ...]]] = defaultdict(dict)

    def number(self, value: Fraction | int) -> Size:
        """An exact number."""
        return Size(0, 0, abs(value.numerator).bit_length(), value.denominator.bit_length())

    def inputs(self, tape: Tape, fixed: Mapping[int, Sequence[Fraction | None]]) -> list[list[Size]]:
        """Free symbols for a tape's inputs, except for elements with known values."""
        known = [fixed.get(position, [None] * size) for position, (_, size) in enumerate(tape.inputs)]
        return [[free() if value is None else self.number(value) for value in values] for values in known]

    def reduced(self, value: Size) -> Size:
        """The size itself."""
        return value

    def inverse(self, value: Size | int) -> Size:
        """1 / value; the numerator of the value must not vanish."""
        value = _sized(value)
        found = self._inverses.get(id(value))
        if found is None:
            found = self._inverses[id(value)] = (value, value.power(-1))  # keeps the object alive, and so its id unique
        return found[1]

    def inverse_matrix(self, rows: Sequence[Sequence[Size | int]]) -> list[list[Size]]:
        """The inverse of a matrix W, by Cramer's rule; the numerator of its determinant must not vanish.

        With B_i the product of the denominators of row i, N = diag(B) W has polynomial entries, and W^-1 has the
        entries cof_ji(N) B_j / det N. A minor of N is a sum of products with one factor from each row. Its degree is
        therefore at most the sum of the largest degrees of these rows, and its height at most the sum of their heights,
        where the height of a row is that of the sum of its entries.
        """
        sized, more = [list(map(_sized, row)) for row in rows], max(len(rows) - 1, 0).bit_length()
        below = [(sum(x.denominator for x in row), sum(x.height_denominator for x in row)) for row in sized]
        pairs = list(zip(sized, below, strict=True))
        degrees = [max(x.degree - x.denominator for x in row) + degree for row, (degree, _) in pairs]
        heights = [max(x.height - x.height_denominator for x in row) + height + more for row, (_, height) in pairs]
        degree, height = sum(degrees), sum(heights)
        self.inverse(Size(degree, 0, height, 0))  # counts the determinant
        columns = [
            (degree - of + lower, height - size + high)
            for of, size, (lower, high) in zip(degrees, heights, below, strict=True)
        ]
        return [[Size(above, degree, size, height) for above, size in columns] for _ in rows]

    def power(self, value: Size, exponent: int) -> Size:
        """An integer power."""
        return value.power(exponent) if exponent >= 0 else self.inverse(value).power(-exponent)

    def call(self, name: str, *given: Size | int) -> Size:
        """Size of a function's value: a point of the circle, a free symbol, or an argument times a sign."""
        arguments = tuple(map(_sized, (*given, _ONE) if name == "if_else_zero" else given))
        function = {"cos": "sin", "fabs": "sign"}.get(name, name)
        self._calls[function][tuple(map(id, arguments))] = arguments
        if name in ("sin", "cos"):
            return Size(2, 2, 1, 1)
        return arguments[0] * free() if name == "fabs" else free()

    def bound(self, outputs: Iterable[Size]) -> Bound:
        """Bound for the test that each of these outputs is zero."""
        degree = height = 0
        for size in outputs:
            degree, height = max(degree, size.degree), max(height, size.height)
        failures = [(value.degree, value.height) for value, _ in self._inverses.values()]
        for function, found in self._calls.items():
            arguments = {id(argument): argument for given in found.values() for argument in given}
            failures.append(_coincidences(list(arguments.values())))
            if function == "sin":
                failures.append((2 * len(arguments), len(arguments)))
        return Bound(degree, height, degree + sum(d for d, _ in failures), height + sum(h for _, h in failures))


def _coincidences(arguments: list[Size]) -> tuple[int, int]:
    """Of k arguments, x = y or x = -y in k (k-1)/2 pairs each, and x = 0 in k cases: k^2 polynomials."""
    degree = max(size.degree for size in arguments) + max(size.denominator for size in arguments)
    height = max(size.height for size in arguments) + max(size.height_denominator for size in arguments) + 1
    return len(arguments) ** 2 * degree, len(arguments) ** 2 * height


def degrees(tape: Tape, fixed: Mapping[int, Sequence[Fraction | None]] | None = None) -> Bound:
    """Bounds on a tape's outputs as functions of their free symbols; `fixed` contains known inputs or elements."""
    ring = Sizes()
    values = evaluated(tape, ring, ring.inputs(tape, fixed or {}))
    return ring.bound(size for output in tape.program.stored(values) for size in output)
