"""Expressions evaluated at real points with so many digits that rounding cannot be taken for a difference."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from decimal import (
    ROUND_CEILING,
    ROUND_FLOOR,
    ROUND_HALF_EVEN,
    Context,
    Decimal,
    DecimalException,
    getcontext,
    localcontext,
)
from fractions import Fraction
from functools import cache
from typing import Final

from dmframe.exact.arithmetic import ARITHMETIC
from dmframe.exact.tape import Tape
from dmframe.program import by_code, run

DIGITS: Final = 60
"""Of each operation. The elementary functions below lose a few."""

_GUARD: Final = 10
CONTEXT: Final = Context(prec=DIGITS + _GUARD)
"""In which decimals are computed here."""

ONE, TWO = Decimal(1), Decimal(2)


class UndefinedHere(ArithmeticError):
    """A function has no real value at this point: a root of a negative number, a division by zero, an overflow."""


def at_point(
    tape: Tape, inputs: Sequence[Sequence[Decimal]], literal: Callable[[Fraction], Decimal] | None = None
) -> list[list[Decimal]]:
    """The outputs of a tape, dense and column-major, at the inputs' values.

    `literal` says what a constant is worth; its decimal value, if it is not given. Raises `UndefinedHere`.
    """
    worth, given = literal or decimal_of, tape.program.elements(inputs)
    with localcontext(CONTEXT):
        try:
            values = run(
                tape.program,
                FUNCTIONS,
                given=lambda i, element: given[i][element],
                constant=lambda number: worth(tape.numbers[number]),
                refuse=KeyError,
            )
        except (DecimalException, KeyError, ValueError) as error:
            raise UndefinedHere(str(error)) from None
        return tape.program.dense(values, Decimal(0))


def decimal_of(value: Fraction) -> Decimal:
    """A rational number to `DIGITS` digits and a few more."""
    return CONTEXT.divide(Decimal(value.numerator), Decimal(value.denominator))


def _pi() -> Decimal:
    return _pi_to(getcontext().prec)


@cache
def _pi_to(digits: int) -> Decimal:
    """Machin: pi = 16 atan(1/5) - 4 atan(1/239)."""
    return 16 * _arctangent_series(ONE / 5) - 4 * _arctangent_series(ONE / 239)


def _arctangent_series(x: Decimal) -> Decimal:
    return _series(x, lambda power, k: -power * x * x, lambda power, k: power / (2 * k + 1))


def _series(
    first: Decimal, step: Callable[[Decimal, int], Decimal], term: Callable[[Decimal, int], Decimal]
) -> Decimal:
    """Sum of term(power, k), the powers made one of the other, until it stands still."""
    total, power, k = term(first, 0), first, 0
    while True:
        k += 1
        power = step(power, k)
        longer = total + term(power, k)
        if longer == total:
            return total
        total = longer


def _sin(x: Decimal) -> Decimal:
    with localcontext() as context:
        context.prec += max(0, x.adjusted() + 1)
        turn = 2 * _pi()
        x = x % turn
    return _series(x, lambda power, k: -power * x * x / (2 * k * (2 * k + 1)), lambda power, k: power)


def _cos(x: Decimal) -> Decimal:
    return _sin(x + _pi() / 2)


def _atan(x: Decimal) -> Decimal:
    halvings = 0
    while abs(x) > Decimal("0.1"):  # atan x = 2 atan(x / (1 + sqrt(1 + x^2)))
        x, halvings = x / (1 + (1 + x * x).sqrt()), halvings + 1
    return TWO**halvings * _arctangent_series(x)


def _asin(x: Decimal) -> Decimal:
    return _pi() / 2 * _sign(x) if abs(x) == 1 else _atan(x / (1 - x * x).sqrt())


def _atan2(y: Decimal, x: Decimal) -> Decimal:
    if x > 0:
        return _atan(y / x)
    if x == 0:
        return _pi() / 2 * _sign(y)
    return _atan(y / x) + (_pi() if y >= 0 else -_pi())


def _sinh(x: Decimal) -> Decimal:
    if abs(x) < 1:
        return _series(x, lambda power, k: power * x * x / (2 * k * (2 * k + 1)), lambda power, k: power)
    return (x.exp() - (-x).exp()) / 2


def _cosh(x: Decimal) -> Decimal:
    return (x.exp() + (-x).exp()) / 2


def _tanh(x: Decimal) -> Decimal:
    return _sinh(x) / _cosh(x) if abs(x) < 2 * CONTEXT.prec else _sign(x)  # beyond, 1 to all digits


def _asinh(x: Decimal) -> Decimal:
    return _sign(x) * (abs(x) + (x * x + 1).sqrt()).ln()


def _erf(x: Decimal) -> Decimal:
    if abs(x) > 6:
        raise UndefinedHere("erf so near to one is not computed")
    series = _series(x, lambda power, k: -power * x * x / k, lambda power, k: power / (2 * k + 1))
    return 2 * series / _pi().sqrt()


def _power(x: Decimal, y: Decimal) -> Decimal:
    if x == 0:
        return Decimal(0) if y > 0 else ONE if y == 0 else ONE / x
    return x**y


def _sign(x: Decimal) -> Decimal:
    return Decimal((x > 0) - (x < 0))


def _copysign(x: Decimal, y: Decimal) -> Decimal:
    return -abs(x) if y < 0 else abs(x)


def _truth(value: object) -> Decimal:
    return ONE if value else Decimal(0)


FUNCTIONS: Final[dict[int, Callable[..., Decimal]]] = ARITHMETIC | by_code(
    {
        "sin": _sin,
        "cos": _cos,
        "sign": _sign,
        "fabs": abs,
        "exp": lambda x: x.exp(),
        "log": lambda x: x.ln(),
        "pow": _power,
        "constpow": _power,
        "sqrt": lambda x: x.sqrt(),
        "tan": lambda x: _sin(x) / _cos(x),
        "asin": _asin,
        "acos": lambda x: _pi() / 2 - _asin(x),
        "atan": _atan,
        "lt": lambda x, y: _truth(x < y),
        "le": lambda x, y: _truth(x <= y),
        "eq": lambda x, y: _truth(x == y),
        "ne": lambda x, y: _truth(x != y),
        "not": lambda x: _truth(not x),
        "and": lambda x, y: _truth(x and y),
        "or": lambda x, y: _truth(x or y),
        "floor": lambda x: x.to_integral_value(ROUND_FLOOR),
        "ceil": lambda x: x.to_integral_value(ROUND_CEILING),
        "fmod": lambda x, y: x % y,
        "remainder": lambda x, y: x - y * (x / y).to_integral_value(ROUND_HALF_EVEN),
        "copysign": _copysign,
        "if_else_zero": lambda x, y: y if x else Decimal(0),
        "fmin": min,
        "fmax": max,
        "sinh": _sinh,
        "cosh": _cosh,
        "tanh": _tanh,
        "asinh": _asinh,
        "acosh": lambda x: (x + (x * x - 1).sqrt()).ln(),
        "atanh": lambda x: ((1 + x) / (1 - x)).ln() / 2,
        "atan2": _atan2,
        "log1p": lambda x: (1 + x).ln(),
        "expm1": lambda x: x.exp() - 1,
        "hypot": lambda x, y: (x * x + y * y).sqrt(),
        "erf": _erf,
    }
)
"""What CasADi's operations give; erfinv is left out."""
