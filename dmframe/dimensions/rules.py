"""Rules for the dimension of the result of each operation, by the operation's code."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Final, final

from dmframe.block.certificate import TINY
from dmframe.dimensions.algebra import ANYTHING, Algebra
from dmframe.dimensions.dimension import NUMBER, PLAIN
from dmframe.program import CONST, INPUT, OPERATIONS, POWERS, Program, by_code

_UNLIMITED: Final = 1e9
"""Numbers from here on mean that there is no limit; they have any unit."""


_TRANSCENDENTAL: Final = ("exp", "expm1", "log", "log1p", "sinh", "cosh", "tanh", "erf", "erfinv")
_CIRCULAR: Final = ("sin", "cos", "tan", "asin", "acos", "atan", "asinh", "acosh", "atanh")


@final
@dataclass(frozen=True)
class Contradiction:
    """The place of the operation whose operands disagree; a single operand is not a plain number where it has to be."""

    node: int
    operands: tuple[int, ...]


class _Refused(Exception):
    """The operands disagree."""


Rule = Callable[..., int]


def dimensions(program: Program, algebra: Algebra, given: Mapping[int, int]) -> tuple[list[int], list[Contradiction]]:
    """The dimension of each value of a program, and the operations whose operands disagree.

    The result of such an operation has any dimension, so that each contradiction is found once. Most instructions cost
    one table look-up.
    """
    rules, numbers = _rules(algebra), _Numbers(algebra)
    values, wrong = list[int](), list[Contradiction]()
    for place, (code, a, b, constant, _) in enumerate(program.nodes):
        try:
            if code == INPUT:
                value = given[place]
            elif code == CONST:
                value = numbers.of(constant)
            elif code in POWERS:
                value = _power(algebra, values[a], program.nodes[b].constant, values[b], program, b)
            elif (rule := rules.get(code)) is not None:
                value = rule(values[a], values[b]) if OPERATIONS[code].arity == 2 else rule(values[a])
            else:
                value = ANYTHING
        except _Refused:
            value = ANYTHING
            wrong.append(Contradiction(place, program.nodes[place].operands))
        values.append(value)
    return values, wrong


@final
class _Numbers:
    """Literal numbers: zero, and values that replace zero or mean no limit, have any dimension."""

    def __init__(self, algebra: Algebra) -> None:
        self._number = algebra.number

    def of(self, value: float) -> int:
        return self._number if TINY < abs(value) < _UNLIMITED else ANYTHING


def _power(algebra: Algebra, base: int, exponent: float, dimension: int, program: Program, place: int) -> int:
    if program.nodes[place].code == CONST:
        return algebra.product(algebra.handle(NUMBER), base, Fraction(exponent).limit_denominator(1000))
    if _agree(algebra, algebra.number, dimension) and _agree(algebra, algebra.number, base):
        return algebra.handle(PLAIN)
    raise _Refused


def _agree(algebra: Algebra, one: int, other: int) -> bool:
    return algebra.same(one, other) is not None


def _rules(algebra: Algebra) -> Mapping[int, Rule]:
    number, plain = algebra.number, algebra.handle(PLAIN)

    def times(a: int, b: int) -> int:
        return algebra.product(a, b)

    def over(a: int, b: int) -> int:
        return algebra.product(a, b, -1)

    def like(a: int, b: int) -> int:
        found = algebra.same(a, b)
        if found is None:
            raise _Refused
        return found

    def compared(a: int, b: int) -> int:
        like(a, b)
        return number

    def of_plain(a: int) -> int:
        like(a, number)
        of = algebra.of(a)
        return number if not a or (of.angular and not any(of.powers)) else plain  # of an angle, it loses the radian

    def angle(a: int, b: int) -> int:
        like(a, b)
        return plain

    def rounded(a: int) -> int:
        like(a, number)
        return number

    def kept(a: int, b: int = 0) -> int:
        return a

    def switched(a: int, b: int) -> int:
        return b

    def truth(a: int, b: int = 0) -> int:
        return number

    return by_code(
        {
            **dict.fromkeys(("add", "sub", "fmin", "fmax", "hypot", "fmod", "remainder"), like),
            **dict.fromkeys(("lt", "le", "eq", "ne"), compared),
            **dict.fromkeys(("not", "and", "or", "sign"), truth),
            **dict.fromkeys(("neg", "twice", "fabs", "copysign"), kept),
            **dict.fromkeys((*_TRANSCENDENTAL, *_CIRCULAR), of_plain),
            **dict.fromkeys(("floor", "ceil"), rounded),
            "atan2": angle,
            "mul": times,
            "div": over,
            "inv": lambda a: over(number, a),
            "sq": lambda a: times(a, a),
            "sqrt": lambda a: algebra.product(number, a, Fraction(1, 2)),
            "if_else_zero": switched,
        }
    )
