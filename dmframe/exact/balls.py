"""CasADi's operations in ball arithmetic: 256-bit numbers with rigorous error bounds, by python-flint (Arb).

A ball [m +/- r] contains all numbers within r of m. The result of an operation contains all exact results
[Johansson2017]_. A comparison of balls is true only if it is true for all their numbers; `!=` is not the negation of
`==`. The precision affects only the width of a ball, never whether the ball contains the result: if another thread
lowers the precision, a proof may fail, but no wrong proof is accepted.

The radius has 30 bits, so that the ends of a wide interval are not sharp: see `dmframe.exact.ranges`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from functools import lru_cache
from math import inf, nextafter
from threading import RLock
from typing import Final

from flint import arb, ctx, fmpq

from dmframe.common.errors import DmframeError
from dmframe.exact.arithmetic import ARITHMETIC
from dmframe.exact.literal import literal
from dmframe.program import COMPARISONS, DIVISIONS, JUMPS, Node, Program, by_code, run, sign_of

BITS: Final = 256
"""Default precision in bits."""

ZERO, ONE = arb(0), arb(1)
UNDECIDED = arb.nan()
"""The value of a comparison that is neither true for all numbers of two balls nor false for all."""

_LOCK: Final = RLock()


class UndecidedError(DmframeError):
    """The value of an expression cannot be decided: an enclosure is too wide, or an operation has no enclosure rule."""


@contextmanager
def precise(bits: int = BITS) -> Iterator[None]:
    """Compute with `bits` bits; a context or a decorator. python-flint has one precision for all threads."""
    with _LOCK, ctx.workprec(bits):
        yield


def _rational(value: Fraction, bits: int) -> arb:
    with precise(bits):
        return arb(fmpq(value.numerator, value.denominator))


@lru_cache(maxsize=4096)
def ball(value: Fraction | float, bits: int = BITS) -> arb:
    """The narrowest ball containing a rational number; a float is read as the decimal it was written as (`literal`)."""
    return _rational(value if isinstance(value, Fraction) else literal(value), bits)


def below(value: arb) -> float:
    """A lower bound on a ball as a float: the largest such float, or the one before."""
    end = value.lower()
    near = float(end)
    return near if arb(near) <= end else nextafter(near, -inf)


def above(value: arb) -> float:
    """An upper bound on a ball as a float: the least such float, or the one after."""
    end = value.upper()
    near = float(end)
    return near if arb(near) >= end else nextafter(near, inf)


Override = Callable[[int, Sequence[arb]], arb | None]


def enclosed(
    program: Program,
    inputs: Sequence[Sequence[arb]],
    constant: Callable[[float], arb] | None = None,
    override: Override | None = None,
    bits: int = BITS,
) -> list[arb]:
    """Enclosures of all nodes of a program.

    An undecided comparison is `UNDECIDED`, and so are "not", "and" and "or" of it. Raises `UndecidedError` if another
    operation depends on it, if an operation is not defined on the whole ball, or if an operation has no rule.

    Parameters
    ----------
    inputs
        Stored elements of each argument.
    constant
        Ball of a literal, by default `ball`.
    override
        Maps the position of a node and the values before it to a value that replaces the node's own, or to None.
    bits
        Precision of the balls.
    """
    values = list[arb]()

    def keep(node: Node, value: arb) -> arb:
        replacement = override(len(values), values) if override else None
        value = value if replacement is None else replacement
        if not value.is_finite() and node.code not in _TRUTHS:
            raise UndecidedError(_reason(node, [values[k] for k in node.operands]))
        values.append(value)
        return value

    with precise(bits):
        return run(
            program,
            RULES,
            given=lambda argument, element: inputs[argument][element],
            constant=constant or (lambda value: ball(value, bits)),
            refuse=lambda code: UndecidedError(f"CasADi's instruction {code} has no enclosure rule"),
            keep=keep,
        )


def _reason(node: Node, operands: Sequence[arb]) -> str:
    """The reason why a value is not finite."""
    if node.code not in RULES:
        return "a number is not finite"
    if node.code in DIVISIONS and not operands[-1].is_nan():
        return "a divisor may be zero"
    if node.code in JUMPS or any(operand.is_nan() for operand in operands):
        return "a comparison cannot be decided"
    return f"the operand of {sign_of(node.code)} may be outside its domain"


def _chosen(yes: bool, no: bool) -> arb:
    return ONE if yes else ZERO if no else UNDECIDED


def _truth(a: arb) -> arb:
    """Whether a number is nonzero."""
    return _chosen(a.is_finite() and 0 not in a, a.is_zero())


def _not(a: arb) -> arb:
    return ONE - _truth(a)


def _both(a: arb, b: arb) -> arb:
    first, second = _truth(a), _truth(b)
    return _chosen(first == 1 and second == 1, first == 0 or second == 0)


def _equal(a: arb, b: arb) -> arb:
    return _chosen(a == b, not a.overlaps(b))


def _where(condition: arb, x: arb) -> arb:
    truth = _truth(condition)
    return x if truth == 1 or x.is_zero() else ZERO if truth == 0 else UNDECIDED


def _sign(a: arb) -> arb:
    return ZERO if a.is_zero() else ONE if a > 0 else -ONE if a < 0 else UNDECIDED


def _exact(a: arb) -> arb:
    """An integer, if it is decided."""
    return a if a.is_exact() else UNDECIDED


def _truncated(a: arb) -> arb:
    return ZERO if abs(a) < 1 else _exact(a.floor()) if a > 0 else _exact(a.ceil())


def _nearest(a: arb) -> arb:
    """The nearest integer; of two, the even one."""
    up = a + 0.5
    whole = _exact(up.floor())
    return whole - 1 if up.is_integer() and not (whole / 2).is_integer() else whole


def _square(a: arb) -> arb:
    return (a * a).nonnegative_part()


def _power(a: arb, b: arb) -> arb:
    if not b.is_integer() or not (a.mid().is_zero() and not a.is_zero() and b > 0):
        return a**b
    most = a.abs_upper() ** b  # Arb has no integer power of a ball around zero
    return (ZERO if (b / 2).is_integer() else -most).union(most)


def _tanh(a: arb) -> arb:
    """Arb's own for a narrow ball; of a wide one the values at its ends, between which it increases."""
    return a.tanh() if a.rad() < 1 else a.lower().tanh().union(a.upper().tanh())


def _copysign(a: arb, b: arb) -> arb:
    return abs(a) if b >= 0 else -abs(a) if b < 0 else UNDECIDED


def _atan2(y: arb, x: arb) -> arb:
    off_the_cut = x > 0 or 0 not in y or (y.is_zero() and (x < 0 or x.is_zero()))
    return arb.atan2(y, x) if off_the_cut else UNDECIDED


_TRUTHS: Final = COMPARISONS | by_code(dict.fromkeys(("not", "and", "or"))).keys()

_OF_ARB: Final = "sqrt exp expm1 log log1p sin cos tan asin acos atan sinh cosh asinh acosh atanh erf".split()

RULES: Final = ARITHMETIC | by_code(
    {
        **{name: getattr(arb, name) for name in _OF_ARB},
        "sq": _square,
        "tanh": _tanh,
        "pow": _power,
        "constpow": _power,
        "hypot": lambda a, b: (_square(a) + _square(b)).sqrt(),
        "atan2": _atan2,
        "fabs": lambda a: abs(a).nonnegative_part(),
        "fmin": arb.min,
        "fmax": arb.max,
        "sign": _sign,
        "copysign": _copysign,
        "floor": lambda a: _exact(a.floor()),
        "ceil": lambda a: _exact(a.ceil()),
        "fmod": lambda a, b: a - b * _truncated(a / b),
        "remainder": lambda a, b: a - b * _nearest(a / b),
        "lt": lambda a, b: _chosen(a < b, a >= b),
        "le": lambda a, b: _chosen(a <= b, a > b),
        "eq": _equal,
        "ne": lambda a, b: _not(_equal(a, b)),
        "not": _not,
        "and": _both,
        "or": lambda a, b: _not(_both(_not(a), _not(b))),
        "if_else_zero": _where,
    }
)
"""All of CasADi's operations except `erfinv`, whose value in CasADi has an error of up to 4e-8."""


__all__ = [
    "BITS",
    "ONE",
    "RULES",
    "UNDECIDED",
    "ZERO",
    "UndecidedError",
    "above",
    "ball",
    "below",
    "enclosed",
    "precise",
]
