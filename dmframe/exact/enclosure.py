r"""Intervals with floating-point ends, many at once: each result encloses the true one, whatever was rounded.

NumPy's sums, products and quotients are those of IEEE 754: the nearest number to the true one. The next number outward,
or one behind it, is therefore an end that encloses it. Its sine and cosine promise no such thing, so they are summed
here, as series with the error that is left out.
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
"""With these a sum reaches the next number, for every finite one [Rump2009]_; ten times as fast as `nextafter`.

The least is the smallest normal number, larger than needed: so it holds too where subnormal ones are flushed to zero.
"""


def down(values: Any) -> Numbers:
    """At most the next numbers below."""
    return np.asarray(values - (np.abs(values) * _STEP + _LEAST))


def up(values: Any) -> Numbers:
    """At least the next numbers above."""
    return np.asarray(values + (np.abs(values) * _STEP + _LEAST))


@final
@dataclass(frozen=True)
class Enclosure:
    """For each place of two arrays, all numbers from `lower` to `upper`.

    Where an operation overflowed, an end is no number: comparisons with it are false, so that nothing follows from it.
    """

    lower: Numbers
    upper: Numbers

    @staticmethod
    def of(value: Any) -> Enclosure:
        """Numbers, taken as exact."""
        return value if isinstance(value, Enclosure) else Enclosure(*[np.asarray(value, dtype=float)] * 2)

    @staticmethod
    def around(value: Fraction) -> Enclosure:
        """A rational number between its neighbours, or itself where it is a floating-point number."""
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
        """A quotient; everything where the divisor holds zero, or the quotient overflows."""
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
        """Not the product with itself, which forgets that both factors are one."""
        low, high = self.lower * self.lower, self.upper * self.upper
        through = (self.lower <= 0) & (self.upper >= 0)
        lower = np.where(through, 0.0, np.maximum(down(np.minimum(low, high)), 0.0))
        return Enclosure(lower, up(np.maximum(low, high)))

    @property
    def magnitude(self) -> Numbers:
        """The largest absolute values."""
        return np.asarray(np.maximum(np.abs(self.lower), np.abs(self.upper)))

    @cached_property
    def on_circle(self) -> tuple[Enclosure, Enclosure]:
        """Sine and cosine, computed once: where a program takes one, it takes the other."""
        return self.sin_cos()

    def sin_cos(self) -> tuple[Enclosure, Enclosure]:
        """Sine and cosine [rad]: the values at both ends, and 1 or -1 where a top or a bottom lies between them."""
        first, last = _sin_cos(self.lower), _sin_cos(self.upper)
        sine = _hull(first[0], last[0], _passes(self, -_QUARTER), _passes(self, _QUARTER))
        return sine, _hull(first[1], last[1], _passes(self, _HALF), _passes(self, Enclosure.of(0.0)))


_PI: Final = Enclosure(np.asarray(math.pi), up(math.pi))
"""math.pi is the floating-point number next below pi."""

_QUARTER: Final = Enclosure(_PI.lower / 2, _PI.upper / 2)
_HALF: Final = _PI
_TURN: Final = Enclosure(_PI.lower * 2, _PI.upper * 2)

_FARTHEST: Final = 1e5
"""Beyond this angle [rad] the reduction to a quarter turn is too coarse."""

_TERMS: Final = 11
_SINE: Final = [Enclosure.around(Fraction((-1) ** k, math.factorial(2 * k + 1))) for k in range(_TERMS)]
_COSINE: Final = [Enclosure.around(Fraction((-1) ** k, math.factorial(2 * k))) for k in range(_TERMS)]
_REST: Final = up(1 / math.factorial(2 * _TERMS))
"""The terms alternate and fall for |y| <= 1, so what is left out is less than the first term left out."""


def _hull(first: Enclosure, last: Enclosure, bottom: NDArray[np.bool_], top: NDArray[np.bool_]) -> Enclosure:
    lower = np.where(bottom, -1.0, np.minimum(first.lower, last.lower))
    upper = np.where(top, 1.0, np.maximum(first.upper, last.upper))
    return Enclosure(np.maximum(lower, -1.0), np.minimum(upper, 1.0))


def _passes(angle: Enclosure, place: Enclosure) -> NDArray[np.bool_]:
    """True where the angle may hold `place` plus whole turns."""
    turns = (angle - place) / _TURN
    return np.asarray(~(np.floor(turns.upper) < np.ceil(turns.lower)))


def _sin_cos(angle: Numbers) -> tuple[Enclosure, Enclosure]:
    """Of exact angles, by the series about the nearest quarter turn."""
    known = np.abs(angle) <= _FARTHEST
    near = np.where(known, angle, 0.0)
    quarter = np.rint(near / (math.pi / 2))
    rest = Enclosure.of(near) - Enclosure.of(quarter) * _QUARTER
    known &= rest.magnitude <= 1
    square, left_out = rest.square(), Enclosure(-_REST, _REST)
    sine, cosine = _series(_SINE, square) * rest + left_out, _series(_COSINE, square) + left_out
    place = quarter.astype(int) % 4
    return _turned(sine, cosine, place, known), _turned(sine, cosine, (place + 1) % 4, known)


def _turned(sine: Enclosure, cosine: Enclosure, quarters: NDArray[np.int_], known: NDArray[np.bool_]) -> Enclosure:
    """The sine of an angle so many quarter turns ahead; from -1 to 1 where it is not known."""
    lower = np.choose(quarters, [sine.lower, cosine.lower, -sine.upper, -cosine.upper])
    upper = np.choose(quarters, [sine.upper, cosine.upper, -sine.lower, -cosine.lower])
    return Enclosure(np.where(known, lower, -1.0), np.where(known, upper, 1.0))


def _series(coefficients: Sequence[Enclosure], square: Enclosure) -> Enclosure:
    total = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        total = total * square + coefficient
    return total


RULES: Final = ARITHMETIC | by_code(
    {"sq": Enclosure.square, "sin": lambda x: x.on_circle[0], "cos": lambda x: x.on_circle[1]}
)


@final
class Enclosing:
    """An SX function, or its program, evaluated in enclosures.

    The default `rules` know field operations, sine and cosine. By default, a literal is the float that it is.
    Raises `ValueFault` for a function that holds any other operation, or a constant that is not finite.
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
        """The values of all nodes of the program; `keep` as of `dmframe.program.run`."""
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
            text = f"expected operations of which an enclosure is known, found {found}"
        return ValueFault(f"{self.program.name}: {text}")
