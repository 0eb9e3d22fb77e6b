"""Symbolic bounds on an expression whose symbols vary in intervals: the rules of `Interval`, as expressions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.common.errors import ValueFault
from dmframe.exact.arithmetic import with_intervals
from dmframe.program import by_code, read, run


@final
@dataclass(frozen=True)
class Ends:
    """Lower and upper bound on a number, as expressions; `defined` is 0 if a divisor can be zero.

    The flag is needed because a NaN does not propagate: CasADi simplifies zero times it to zero, and `fmin` ignores it.
    """

    lower: Any
    upper: Any
    defined: Any = 1

    @staticmethod
    def of(value: Any) -> Ends:
        """An expression as an interval of zero width."""
        return value if isinstance(value, Ends) else Ends(value, value)

    def __add__(self, other: Ends) -> Ends:
        return Ends(self.lower + other.lower, self.upper + other.upper, _both(self, other))

    def __neg__(self) -> Ends:
        return Ends(-self.upper, -self.lower, self.defined)

    def __sub__(self, other: Ends) -> Ends:
        return self + (-other)

    def __mul__(self, other: Ends) -> Ends:
        first, *others = (a * b for a in (self.lower, self.upper) for b in (other.lower, other.upper))
        low = high = first
        for product in others:
            low, high = ca.fmin(low, product), ca.fmax(high, product)
        return Ends(low, high, _both(self, other))

    def __truediv__(self, other: Ends) -> Ends:
        defined = ca.logic_and(other.defined, other.lower * other.upper > 0)
        return self * Ends(1 / other.upper, 1 / other.lower, defined)

    def __rtruediv__(self, other: int) -> Ends:
        return Ends.of(ca.SX(other)) / self

    def square(self) -> Ends:
        """Square; tighter than the product with itself, in which the factors count as independent."""
        ends = self.lower * self.lower, self.upper * self.upper
        least = ca.if_else(ca.logic_and(self.lower <= 0, self.upper >= 0), 0, ca.fmin(*ends))
        return Ends(least, ca.fmax(*ends), self.defined)


def enclosing(expression: Any, inside: Mapping[int, tuple[float, float]], *, waves: bool = False) -> Ends:
    """Bounds on a column, element by element; `inside` maps symbols, by identity, to their intervals.

    With `waves` a sine or cosine of an uncertain argument is bounded by -1 and 1. Both bounds are NaN if a divisor can
    be zero.

    Raises `ValueFault` for any operation other than these and those of a field.
    """
    symbols = ca.symvar(expression)
    program = read(ca.Function("ends", symbols, [ca.vec(ca.densify(expression))]))

    def given(argument: int, element: int) -> Any:
        symbol = symbols[argument]
        ends = inside.get(symbol.element_hash())
        return symbol if ends is None else Ends(*map(ca.SX, ends))

    values = run(
        program,
        _RULES | _WAVES if waves else _RULES,
        given=given,
        constant=ca.SX,
        refuse=lambda code: ValueFault(f"expected + - * / only, found CasADi's instruction {code}"),
    )
    (found,) = program.stored(values)
    ends = [Ends.of(value) for value in found]
    lower = (ca.if_else(e.defined, e.lower, np.nan) for e in ends)
    upper = (ca.if_else(e.defined, e.upper, np.nan) for e in ends)
    return Ends(ca.vertcat(ca.SX(0, 1), *lower), ca.vertcat(ca.SX(0, 1), *upper))


def _both(one: Ends, other: Ends) -> Any:
    """Expression that is true if both numbers are defined."""
    return ca.logic_and(one.defined, other.defined)


_RULES: Final = with_intervals(Ends)
_WAVES: Final = by_code({
    "sin": lambda x: Ends(ca.SX(-1), ca.SX(1), x.defined) if isinstance(x, Ends) else ca.sin(x),
    "cos": lambda x: Ends(ca.SX(-1), ca.SX(1), x.defined) if isinstance(x, Ends) else ca.cos(x),
})  # fmt: skip
