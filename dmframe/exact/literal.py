"""Floats in expressions, read as the rational numbers that they were written as."""

from __future__ import annotations

import math
from fractions import Fraction
from functools import lru_cache
from typing import Final

from dmframe.common.errors import ValueFault
from dmframe.robot.rational import simplest_between

WRITTEN_DIGITS: Final = 15
"""A decimal of so many digits comes back from its float; a longer one was computed, not written."""

SHORT_BITS: Final = 30
"""An odd numerator of so few bits over a power of two is a float without rounding."""

SMALL_DENOMINATOR: Final = 10**4
"""Of a fraction such as 1/3: none so small lies near a float by chance."""


@lru_cache(maxsize=4096)
def literal(value: float) -> Fraction:
    """The rational number that a float in an expression stands for.

    Without this -0.1 x - 0.2 x + 0.3 x would not vanish: the three floats miss their decimals by different amounts. In
    this order: a float of few bits is itself (0.75); a decimal of at most 15 digits is that decimal (0.1 is 1/10); a
    fraction with a small denominator is that fraction (1/3); any other float is its exact binary value.

    Each answer lies within half a unit of the float's last place, so that two different floats never read alike: no
    two numbers are taken for equal that are not. The loop that is run differs from the one that is proved by the
    rounding of its literals, as it does by that of its arithmetic. What Python or CasADi has folded already stays
    folded: 0.1 + 0.2 gives 0.30000000000000004, not 3/10.

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
    simple = simplest_between(exact - half, exact + half)
    return simple if simple.denominator <= SMALL_DENOMINATOR and float(simple) == value else exact


def exact(value: float | Fraction) -> Fraction:
    """The rational number of a constant: a fraction is itself, a float what it stands for."""
    return value if isinstance(value, Fraction) else literal(value)


def computed(value: Fraction) -> bool:
    """True for a `literal` that no rule but the last one reads: what a program computed, and rounded."""
    return value.denominator & (value.denominator - 1) == 0 and rounded(float(value))


def rounded(value: float) -> bool:
    """True unless the float is, by its few bits, the very number that was meant."""
    numerator = abs(Fraction(value).numerator)
    return bool(numerator) and (numerator // (numerator & -numerator)).bit_length() > SHORT_BITS
