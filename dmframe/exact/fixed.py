"""Intervals with ends of many binary places: enclosures that stay narrow through an exponential of a stiff matrix.

An end is a Python integer, so many times 2^-256. Sums are exact; a product or a quotient is rounded outward by one
unit. Nothing overflows, and what is small is only small: 256 places leave room for what products and powers lose.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any, Final, final

from dmframe.errors import DmframeError
from dmframe.exact.arithmetic import ARITHMETIC
from dmframe.exact.literal import literal
from dmframe.program import Program, by_code, run, sign_of

PLACES: Final = 256
"""Binary places after the point."""

ONE: Final = 1 << PLACES


class UndecidedError(DmframeError):
    """An enclosure is too wide, or an operation unknown, to say what an expression is."""


@final
class Fixed:
    """All numbers from `lower` to `upper`, both in units of 2^-256."""

    __slots__ = ("lower", "upper")

    def __init__(self, lower: int, upper: int) -> None:
        self.lower, self.upper = lower, upper

    @staticmethod
    def around(value: Fraction | float) -> Fixed:
        """A rational number; a float is the decimal that it was written as."""
        exact = value if isinstance(value, Fraction) else literal(value)
        scaled = exact.numerator << PLACES
        return Fixed(scaled // exact.denominator, -(-scaled // exact.denominator))

    @property
    def middle(self) -> int:
        """The middle, rounded down."""
        return (self.lower + self.upper) >> 1

    def __float__(self) -> float:
        return float(Fraction(self.middle, ONE))

    @property
    def width(self) -> float:
        """From the lower to the upper end."""
        return float(Fraction(self.upper - self.lower, ONE))

    def __repr__(self) -> str:
        return f"Fixed({float(self):.17g} +- {self.width / 2:.2g})"

    def __add__(self, other: Fixed) -> Fixed:
        return Fixed(self.lower + other.lower, self.upper + other.upper)

    def __neg__(self) -> Fixed:
        return Fixed(-self.upper, -self.lower)

    def __sub__(self, other: Fixed) -> Fixed:
        return Fixed(self.lower - other.upper, self.upper - other.lower)

    def __mul__(self, other: Fixed) -> Fixed:
        a, b, c, d = self.lower, self.upper, other.lower, other.upper
        if a == b and c == d:
            product = a * c
            return Fixed(product >> PLACES, -(-product >> PLACES))
        products = (a * c, a * d, b * c, b * d)
        return Fixed(min(products) >> PLACES, -(-max(products) >> PLACES))

    def __truediv__(self, other: Fixed) -> Fixed:
        if other.lower <= 0 <= other.upper:
            raise UndecidedError("a divisor may be zero")
        ends = [(a << PLACES, b) for a in (self.lower, self.upper) for b in (other.lower, other.upper)]
        return Fixed(min(a // b for a, b in ends), max(-(-a // b) for a, b in ends))

    def __rtruediv__(self, other: int) -> Fixed:
        return Fixed(other << PLACES, other << PLACES) / self

    def square(self) -> Fixed:
        """Not the product with itself, which forgets that both factors are one."""
        low, high = sorted((self.lower * self.lower, self.upper * self.upper))
        return Fixed(0 if self.lower <= 0 <= self.upper else low >> PLACES, -(-high >> PLACES))

    def sqrt(self) -> Fixed:
        """The root; refused where a number may be negative."""
        if self.lower < 0:
            raise UndecidedError("a root's operand may be negative")
        root = math.isqrt(self.upper << PLACES)
        return Fixed(math.isqrt(self.lower << PLACES), root + 1)

    def sin_cos(self) -> tuple[Fixed, Fixed]:
        """Sine and cosine [rad] at the middle, and beside it by no more than the distance."""
        middle = self.middle
        reach = max(self.upper - middle, middle - self.lower)
        halvings = max(0, abs(middle).bit_length() - PLACES)
        if halvings > _MOST_HALVINGS:
            raise UndecidedError("an angle is too large")
        part = Fixed(middle >> halvings, -(-middle >> halvings))
        square = part.square()
        sine, cosine = _series(part, square, 1), _series(Fixed(ONE, ONE), square, 0)
        for _ in range(halvings):
            sine, cosine = _twice(sine * cosine), Fixed(ONE, ONE) - _twice(sine.square())
        return _widened(sine, reach), _widened(cosine, reach)

    def exp(self) -> Fixed:
        """The exponential, which rises: its ends are those of the ends."""
        return Fixed(_exp(self.lower).lower, _exp(self.upper).upper)

    def tanh(self) -> Fixed:
        """The hyperbolic tangent, which rises."""
        return Fixed(_tanh(self.lower).lower, _tanh(self.upper).upper)

    def absolute(self) -> Fixed:
        """The absolute value."""
        ends = abs(self.lower), abs(self.upper)
        return Fixed(0 if self.lower <= 0 <= self.upper else min(ends), max(ends))


_MOST_HALVINGS: Final = 64
_FLAT: Final = 100 << PLACES
"""Beyond it tanh is 1 up to less than 2^-256."""


@final
class _Maybe:
    """Neither true nor false; it counts as no number."""

    @property
    def lower(self) -> int:
        """Refused."""
        raise UndecidedError("whether a comparison holds cannot be decided")

    upper = lower

    def _refused(self, *_: object) -> Fixed:
        raise UndecidedError("whether a comparison holds cannot be decided")

    __add__ = __mul__ = __sub__ = __truediv__ = __rtruediv__ = __neg__ = _refused


_NO, _YES, MAYBE = Fixed(0, 0), Fixed(ONE, ONE), _Maybe()


def _twice(x: Fixed) -> Fixed:
    return x + x


def _widened(x: Fixed, reach: int) -> Fixed:
    return Fixed(max(x.lower - reach, -ONE), min(x.upper + reach, ONE))


def _series(first: Fixed, square: Fixed, odd: int) -> Fixed:
    """Of a sine or a cosine for |x| <= 1: the terms alternate and fall, so what is left out is less than the next."""
    total, term, k = first, first, odd
    while max(abs(term.lower), abs(term.upper)) > 1:
        term = -(term * square) / Fixed((k + 1) * (k + 2) << PLACES, (k + 1) * (k + 2) << PLACES)
        total, k = total + term, k + 2
    return Fixed(total.lower - 2, total.upper + 2)


def _exp(x: int) -> Fixed:
    """Of an exact number: the series for x/2^k, squared k times."""
    halvings = max(0, abs(x).bit_length() - PLACES + 1)
    if halvings > _MOST_HALVINGS // 4:
        raise UndecidedError("an exponent is too large")
    part = Fixed(x >> halvings, -(-x >> halvings))
    total, term, k = _YES, _YES, 0
    while max(abs(term.lower), abs(term.upper)) > 1:  # each is less than half of the one before
        term, k = term * part / Fixed((k + 1) << PLACES, (k + 1) << PLACES), k + 1
        total = total + term
    total = Fixed(total.lower - 2, total.upper + 2)
    for _ in range(halvings):
        total = total.square()
    return total


def _tanh(x: int) -> Fixed:
    if abs(x) > _FLAT:
        return Fixed(ONE - 1, ONE) if x > 0 else Fixed(-ONE, 1 - ONE)
    power = _exp(2 * x)
    return (power - _YES) / (power + _YES)


def _less(a: Fixed, b: Fixed) -> Any:
    return _YES if a.upper < b.lower else _NO if a.lower >= b.upper else MAYBE


def _at_most(a: Fixed, b: Fixed) -> Any:
    return _YES if a.upper <= b.lower else _NO if a.lower > b.upper else MAYBE


def _equal(a: Fixed, b: Fixed) -> Any:
    if a.upper < b.lower or b.upper < a.lower:
        return _NO
    return _YES if a.lower == a.upper == b.lower == b.upper else MAYBE


def _truth(a: Any) -> Any:
    """Whether a number is other than zero."""
    if a is MAYBE:
        return MAYBE
    return _NO if a.lower == a.upper == 0 else MAYBE if a.lower <= 0 <= a.upper else _YES


def _not(a: Any) -> Any:
    return {_YES: _NO, _NO: _YES, MAYBE: MAYBE}[_truth(a)]


def _both(a: Any, b: Any) -> Any:
    found = _truth(a), _truth(b)
    return _NO if _NO in found else MAYBE if MAYBE in found else _YES


def _where(condition: Any, x: Fixed) -> Fixed:
    if x.lower == x.upper == 0:
        return x
    truth = _truth(condition)
    if truth is MAYBE:
        raise UndecidedError("whether a comparison holds cannot be decided")
    return x if truth is _YES else _NO


def _sign(a: Fixed) -> Fixed:
    if a.lower <= 0 <= a.upper and (a.lower, a.upper) != (0, 0):
        raise UndecidedError("a sign cannot be decided")
    return Fixed(ONE, ONE) if a.lower > 0 else Fixed(-ONE, -ONE) if a.upper < 0 else _NO


FIXED_RULES: Final = ARITHMETIC | by_code(
    {
        "sq": Fixed.square,
        "sqrt": Fixed.sqrt,
        "sin": lambda x: x.sin_cos()[0],
        "cos": lambda x: x.sin_cos()[1],
        "exp": Fixed.exp,
        "tanh": Fixed.tanh,
        "fabs": Fixed.absolute,
        "fmin": lambda a, b: Fixed(min(a.lower, b.lower), min(a.upper, b.upper)),
        "fmax": lambda a, b: Fixed(max(a.lower, b.lower), max(a.upper, b.upper)),
        "sign": _sign,
        "lt": _less,
        "le": _at_most,
        "eq": _equal,
        "ne": lambda a, b: _not(_equal(a, b)),
        "not": _not,
        "and": _both,
        "or": lambda a, b: _not(_both(_not(a), _not(b))),
        "if_else_zero": _where,
    }
)


def fixed_values(program: Program, inputs: Sequence[Sequence[Fixed]]) -> list[Any]:
    """The values of all nodes, enclosed; an input is a list of its stored elements.

    Raises `UndecidedError` for an operation that is not known here, or that cannot be decided.
    """
    return run(
        program,
        FIXED_RULES,
        given=lambda argument, element: inputs[argument][element],
        constant=Fixed.around,
        refuse=lambda code: UndecidedError(f"no enclosure is known of {sign_of(code)}"),
    )


__all__ = ["FIXED_RULES", "MAYBE", "ONE", "PLACES", "Fixed", "UndecidedError", "fixed_values"]
