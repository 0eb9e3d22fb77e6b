r"""Arrays of intervals with floating-point ends: each result encloses the exact one, including rounding errors.

NumPy's sums, products and quotients follow IEEE 754: they are the nearest number to the exact result. The next number
outward, or the one after it, is therefore a valid end. NumPy's sine and cosine have no such guarantee, so they are
computed here as series with a bound on the remainder.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from dmframe.common.errors import ValueFault
from dmframe.exact.arithmetic import ARITHMETIC
from dmframe.program import CONST, INPUT, OPERATIONS, Node, Program, by_code, read, run

Numbers = NDArray[np.float64]


_STEP: Final = 2.0**-53 * (1 + 2.0**-52)
_LEAST: Final = sys.float_info.min
"""A sum with these reaches the next number, for every finite one [Rump2009]_; ten times as fast as `nextafter`.

The least is the smallest normal number, larger than needed, so that it is valid if subnormal numbers are flushed to
zero.
"""


def down(values: Any) -> Numbers:
    """Numbers less than or equal to the next numbers below."""
    return np.asarray(values - (np.abs(values) * _STEP + _LEAST))


def up(values: Any) -> Numbers:
    """Numbers greater than or equal to the next numbers above."""
    return np.asarray(values + (np.abs(values) * _STEP + _LEAST))


@final
@dataclass(frozen=True)
class Enclosure:
    """Elementwise intervals from `lower` to `upper`, two arrays.

    After an overflow an end is NaN: comparisons with it are false, so that no conclusion is drawn from it.
    """

    lower: Numbers
    upper: Numbers

    @staticmethod
    def of(value: Any) -> Enclosure:
        """Enclosure of zero width around exact numbers."""
        return value if isinstance(value, Enclosure) else Enclosure(*[np.asarray(value, dtype=float)] * 2)

    @staticmethod
    def around(value: Fraction) -> Enclosure:
        """Enclosure of a rational number: its neighbours, or the number itself if it is a floating-point number."""
        near = float(value)
        return Enclosure.of(near) if Fraction(near) == value else Enclosure(down(near), up(near))

    def __add__(self, other: Any) -> Enclosure:
        other = Enclosure.of(other)
        return Enclosure(down(self.lower + other.lower), up(self.upper + other.upper))

    def __neg__(self) -> Enclosure:
        return Enclosure(-self.upper, -self.lower)

    def __sub__(self, other: Any) -> Enclosure:
        return self + (-Enclosure.of(other))

    def __mul__(self, other: Any) -> Enclosure:
        other = Enclosure.of(other)
        left, right = self.lower * other.lower, self.lower * other.upper
        if self.lower is self.upper:  # a number: two products are enough
            return Enclosure(down(np.minimum(left, right)), up(np.maximum(left, right)))
        first, last = self.upper * other.lower, self.upper * other.upper
        lower = np.minimum(np.minimum(left, right), np.minimum(first, last))
        upper = np.maximum(np.maximum(left, right), np.maximum(first, last))
        return Enclosure(down(lower), up(upper))

    def __truediv__(self, other: Any) -> Enclosure:
        """Quotient; the whole line if the divisor contains zero or the quotient overflows."""
        other = Enclosure.of(other)
        through = (other.lower <= 0) & (other.upper >= 0)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            inverse = Enclosure(down(1 / other.upper), up(1 / other.lower))
            found = self * inverse
            vague = through | ~np.isfinite(found.lower + found.upper)
        return Enclosure(np.where(vague, -np.inf, found.lower), np.where(vague, np.inf, found.upper))

    def __rtruediv__(self, other: Any) -> Enclosure:
        return Enclosure.of(other) / self

    def square(self) -> Enclosure:
        """Square; tighter than the product with itself, in which the factors count as independent."""
        low, high = self.lower * self.lower, self.upper * self.upper
        through = (self.lower <= 0) & (self.upper >= 0)
        lower = np.where(through, 0.0, np.maximum(down(np.minimum(low, high)), 0.0))
        return Enclosure(lower, up(np.maximum(low, high)))

    @property
    def magnitude(self) -> Numbers:
        """The largest absolute values."""
        return np.asarray(np.maximum(np.abs(self.lower), np.abs(self.upper)))

    @cached_property
    def sine_and_cosine(self) -> tuple[Enclosure, Enclosure]:
        """Sine and cosine, computed once, since a program that contains one usually contains the other."""
        return self.sin_cos()

    def sin_cos(self) -> tuple[Enclosure, Enclosure]:
        """Sine and cosine [rad]: the values at both ends, extended to 1 or -1 if the interval contains an extremum."""
        first, last = _sin_cos(self.lower), _sin_cos(self.upper)
        sine = _hull(first[0], last[0], _passes(self, -_QUARTER), _passes(self, _QUARTER))
        return sine, _hull(first[1], last[1], _passes(self, _HALF), _passes(self, Enclosure.of(0.0)))


_PI: Final = Enclosure(np.asarray(math.pi), up(math.pi))
"""math.pi is the floating-point number next below pi."""

_QUARTER: Final = Enclosure(_PI.lower / 2, _PI.upper / 2)
_HALF: Final = _PI
_TURN: Final = Enclosure(_PI.lower * 2, _PI.upper * 2)

_FARTHEST: Final = 1e5
"""Largest angle [rad] for which the reduction to a quarter turn is accurate enough."""

_TERMS: Final = 11
_SINE: Final = [Enclosure.around(Fraction((-1) ** k, math.factorial(2 * k + 1))) for k in range(_TERMS)]
_COSINE: Final = [Enclosure.around(Fraction((-1) ** k, math.factorial(2 * k))) for k in range(_TERMS)]
_REST: Final = up(1 / math.factorial(2 * _TERMS))
"""The terms alternate and decrease for |y| <= 1, so the remainder is less than the first omitted term."""


def _hull(first: Enclosure, last: Enclosure, bottom: NDArray[np.bool_], top: NDArray[np.bool_]) -> Enclosure:
    lower = np.where(bottom, -1.0, np.minimum(first.lower, last.lower))
    upper = np.where(top, 1.0, np.maximum(first.upper, last.upper))
    return Enclosure(np.maximum(lower, -1.0), np.minimum(upper, 1.0))


def _passes(angle: Enclosure, place: Enclosure) -> NDArray[np.bool_]:
    """True if the angle may be `place` plus a multiple of a full turn."""
    turns = (angle - place) / _TURN
    return np.asarray(~(np.floor(turns.upper) < np.ceil(turns.lower)))


def _sin_cos(angle: Numbers) -> tuple[Enclosure, Enclosure]:
    """Sine and cosine of exact angles, by the series about the nearest quarter turn."""
    known = np.abs(angle) <= _FARTHEST
    near = np.where(known, angle, 0.0)
    quarter = np.rint(near / (math.pi / 2))
    reduced = Enclosure.of(near) - Enclosure.of(quarter) * _QUARTER
    known &= reduced.magnitude <= 1
    square, remainder = reduced.square(), Enclosure(-_REST, _REST)
    sine, cosine = _series(_SINE, square) * reduced + remainder, _series(_COSINE, square) + remainder
    place = quarter.astype(int) % 4
    return _turned(sine, cosine, place, known), _turned(sine, cosine, (place + 1) % 4, known)


def _turned(sine: Enclosure, cosine: Enclosure, quarters: NDArray[np.int_], known: NDArray[np.bool_]) -> Enclosure:
    """Sine of an angle advanced by `quarters` quarter turns; from -1 to 1 where it is not known."""
    lower = np.choose(quarters, [sine.lower, cosine.lower, -sine.upper, -cosine.upper])
    upper = np.choose(quarters, [sine.upper, cosine.upper, -sine.lower, -cosine.lower])
    return Enclosure(np.where(known, lower, -1.0), np.where(known, upper, 1.0))


def _series(coefficients: Sequence[Enclosure], square: Enclosure) -> Enclosure:
    total = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        total = total * square + coefficient
    return total


RULES: Final = ARITHMETIC | by_code(
    {"sq": Enclosure.square, "sin": lambda x: x.sine_and_cosine[0], "cos": lambda x: x.sine_and_cosine[1]}
)


@final
class Enclosing:
    """Evaluation of an SX function, or of its program, in enclosures.

    The default `rules` contain field operations, sine and cosine. By default, a literal has its exact binary value.
    Raises `ValueFault` for a function with any other operation, or a constant that is not finite.
    """

    def __init__(
        self,
        f: Any,
        rules: Mapping[int, Callable[..., Any]] = RULES,
        constant: Callable[[float], Enclosure] = Enclosure.of,
    ) -> None:
        self.program, self._rules, self._constant = f if isinstance(f, Program) else read(f), rules, constant
        for code, _, _, number, _ in self.program.nodes:
            if code not in rules and code not in (INPUT, CONST):
                raise self._refuse(code)
            if not math.isfinite(number):
                raise ValueFault(f"{self.program.name}: expected finite constants, found {number}")

    def __call__(self, inputs: Sequence[Sequence[Any]]) -> list[list[Enclosure]]:
        """The stored elements of each output; an input is a list of its elements, numbers or enclosures."""
        return self.program.stored(self.values(inputs))

    def values(
        self, inputs: Sequence[Sequence[Any]], keep: Callable[[Node, Enclosure], Enclosure] | None = None
    ) -> list[Enclosure]:
        """The values of all nodes of the program; `keep` as in `dmframe.program.run`."""
        with np.errstate(invalid="ignore", over="ignore"):
            return run(
                self.program,
                self._rules,
                given=lambda argument, element: Enclosure.of(inputs[argument][element]),
                constant=self._constant,
                refuse=self._refuse,
                keep=keep,
            )

    def _refuse(self, code: int) -> ValueFault:
        if self._rules is RULES:
            text = f"expected + - * /, sin and cos only, found CasADi's instruction {code}"
        else:
            found = OPERATIONS[code].name if code in OPERATIONS else f"CasADi's instruction {code}"
            text = f"expected operations with an enclosure rule, found {found}"
        return ValueFault(f"{self.program.name}: {text}")
