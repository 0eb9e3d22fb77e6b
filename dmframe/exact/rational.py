"""Evaluation of expressions in rational numbers and in intervals with rational ends: signs without rounding errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Final, final

from dmframe.common.errors import ValueFault
from dmframe.exact.arithmetic import with_intervals
from dmframe.exact.literal import literal
from dmframe.program import CONST, INPUT, Program, read, run


@final
@dataclass(frozen=True)
class Interval:
    """All numbers from `lower` to `upper`; operations enclose every result."""

    lower: Fraction
    upper: Fraction

    @staticmethod
    def of(value: Fraction | Interval) -> Interval:
        """A number as an interval of zero width."""
        return value if isinstance(value, Interval) else Interval(value, value)

    def __add__(self, other: Fraction | Interval) -> Interval:
        other = Interval.of(other)
        return Interval(self.lower + other.lower, self.upper + other.upper)

    def __neg__(self) -> Interval:
        return Interval(-self.upper, -self.lower)

    def __sub__(self, other: Fraction | Interval) -> Interval:
        return self + (-Interval.of(other))

    def __mul__(self, other: Fraction | Interval) -> Interval:
        other = Interval.of(other)
        ends = [a * b for a in (self.lower, self.upper) for b in (other.lower, other.upper)]
        return Interval(min(ends), max(ends))

    def __truediv__(self, other: Fraction | Interval) -> Interval:
        other = Interval.of(other)
        if other.lower <= 0 <= other.upper:
            raise ZeroDivisionError
        return self * Interval(1 / other.upper, 1 / other.lower)

    def __rtruediv__(self, other: int) -> Interval:
        return Interval.of(Fraction(other)) / self

    def square(self) -> Interval:
        """Square; tighter than the product with itself, in which the factors count as independent."""
        ends = sorted((self.lower * self.lower, self.upper * self.upper))
        return Interval(Fraction(0) if self.lower <= 0 <= self.upper else ends[0], ends[1])


def evaluate(f: Any, inputs: Sequence[Sequence[Fraction | Interval]]) -> list[list[Fraction | Interval]]:
    """Exact outputs of an SX function of field operations.

    Raises `ValueFault` for any other function (sin, tanh, ...), ZeroDivisionError if a divisor is or contains zero.
    """
    program = read(f)
    values = run(
        program,
        RULES,
        given=lambda argument, element: inputs[argument][element],
        constant=lambda number: _exact(number, program.name),
        refuse=lambda code: ValueFault(
            f"{program.name}: expected + - * / only, found CasADi's instruction {code}; its sign cannot be decided"
        ),
    )
    return program.stored(values)


def known_values(program: Program, inputs: Sequence[Sequence[Fraction | Interval]]) -> list[Fraction | Interval | None]:
    """Elements of all outputs; None for one that depends on a free symbol or on what `evaluate` cannot compute."""
    values = list[Fraction | Interval | None]()
    for node in program.nodes:
        value: Any = None
        operands = [values[k] for k in node.operands]
        with suppress(ZeroDivisionError, ValueFault):
            if node.code == INPUT:
                value = inputs[node.a][node.b]
            elif node.code == CONST:
                value = literal(node.constant)
            elif node.code in RULES and None not in operands:
                value = RULES[node.code](*operands)
        values.append(value)
    return [value for output in program.stored(values) for value in output]


def as_float(value: Fraction | Interval) -> float:
    """The nearest float, for display: infinite beyond the largest one; of an interval, its lower end."""
    exact = value.lower if isinstance(value, Interval) else value
    try:
        return float(exact)
    except OverflowError:
        return math.inf if exact > 0 else -math.inf


def _exact(constant: float, name: str) -> Fraction:
    try:
        return literal(constant)
    except ValueFault as error:
        raise ValueFault(f"{name}: {error.text}") from None


RULES: Final = with_intervals(Interval)
