"""Floats in expressions, read as the rational numbers that they were written as."""

from __future__ import annotations

import math
from fractions import Fraction
from functools import lru_cache
from typing import Final

from dmframe.common.errors import ValueFault
from dmframe.robot.rational import simplest_between

WRITTEN_DIGITS: Final = 15
"""Number of digits up to which a decimal is recovered from its float; a longer one was computed, not written."""

SHORT_BITS: Final = 30
"""Number of bits of an odd numerator, over a power of two, up to which a float is exact."""

SMALL_DENOMINATOR: Final = 10**4
"""Largest denominator of a fraction such as 1/3; no float is close to one by chance."""


@lru_cache(maxsize=4096)
def literal(value: float) -> Fraction:
    """The rational number that a float in an expression represents.

    Without this -0.1 x - 0.2 x + 0.3 x would not vanish, since the three floats have different rounding errors. The
    rules are, in this order: a float of few bits has its exact value (0.75); a decimal of at most 15 digits is that
    decimal (0.1 is 1/10); a fraction with a small denominator is that fraction (1/3); any other float has its exact
    binary value.

    The result is within half a unit in the last place of the float, so that two different floats always have different
    results. The difference between the simulated loop and the proved one is the rounding of literals and of arithmetic.
    Constants that Python or CasADi has already combined are not recovered: 0.1 + 0.2 gives 0.30000000000000004, not
    3/10.

    Raises `ValueFault` for a value that is not finite.
    """
    if not math.isfinite(value):
        raise ValueFault(f"expected finite constants, found {value}")
    exact = Fraction(value)
    if not rounded(value):
        return exact
    text = repr(value)
    if len(text.lstrip("-").partition("e")[0].replace(".", "").strip("0")) <= WRITTEN_DIGITS:
        return Fraction(text)
    half = Fraction(math.ulp(value)) / 2
    if abs(exact.limit_denominator(SMALL_DENOMINATOR) - exact) > half:  # the usual case, in a tenth of the time
        return exact
    simple = simplest_between(exact - half, exact + half)
    return simple if simple.denominator <= SMALL_DENOMINATOR and float(simple) == value else exact


def exact(value: float | Fraction) -> Fraction:
    """The rational number of a constant: a fraction itself, or the `literal` of a float."""
    return value if isinstance(value, Fraction) else literal(value)


def computed(value: Fraction) -> bool:
    """True for a `literal` to which only the last rule applies: a value that a program has computed and rounded."""
    return value.denominator & (value.denominator - 1) == 0 and rounded(float(value))


def rounded(value: float) -> bool:
    """True unless the float has so few bits that it is exact."""
    numerator = abs(Fraction(value).numerator)
    return bool(numerator) and (numerator // (numerator & -numerator)).bit_length() > SHORT_BITS
