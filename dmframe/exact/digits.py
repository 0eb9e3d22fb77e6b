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

import casadi as ca

from dmframe.exact.arithmetic import ARITHMETIC
from dmframe.exact.tape import Tape

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
    constants = literal or decimal_of
    with localcontext(CONTEXT):
        flat = [value for vector in inputs for value in vector]
        values: list[Decimal] = []
        try:
            for code, a, b, arguments, constant in tape.nodes:
                if code == ca.OP_INPUT:
                    values.append(flat[a])
                elif code == ca.OP_CONST:
                    values.append(constants(constant))
                elif code == ca.OP_POW:
                    values.append(values[a] ** b)
                elif code == CALL:
                    values.append(FUNCTIONS[a](*(values[argument] for argument in arguments)))
                else:
                    values.append(FUNCTIONS[code](*((values[a], values[b])[: _ARITY.get(code, 1)])))
        except (DecimalException, KeyError, ValueError) as error:
            raise UndefinedHere(str(error)) from None
        results = []
        for output in tape.outputs:
            dense = [Decimal(0)] * output.size
            for place, source in zip(output.places, output.sources, strict=True):
                dense[place] = values[source]
            results.append(dense)
        return results


CALL: Final = -1
"""The code of a tape's node for any function beyond the field; its `a` says which."""

_ARITY: Final = {ca.OP_ADD: 2, ca.OP_SUB: 2, ca.OP_MUL: 2, ca.OP_DIV: 2}


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


FUNCTIONS: Final[dict[int, Callable[..., Decimal]]] = {
    **ARITHMETIC,
    ca.OP_SIN: _sin,
    ca.OP_COS: _cos,
    ca.OP_SIGN: _sign,
    ca.OP_FABS: abs,
    ca.OP_EXP: lambda x: x.exp(),
    ca.OP_LOG: lambda x: x.ln(),
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_SQRT: lambda x: x.sqrt(),
    ca.OP_TAN: lambda x: _sin(x) / _cos(x),
    ca.OP_ASIN: _asin,
    ca.OP_ACOS: lambda x: _pi() / 2 - _asin(x),
    ca.OP_ATAN: _atan,
    ca.OP_LT: lambda x, y: _truth(x < y),
    ca.OP_LE: lambda x, y: _truth(x <= y),
    ca.OP_EQ: lambda x, y: _truth(x == y),
    ca.OP_NE: lambda x, y: _truth(x != y),
    ca.OP_NOT: lambda x: _truth(not x),
    ca.OP_AND: lambda x, y: _truth(x and y),
    ca.OP_OR: lambda x, y: _truth(x or y),
    ca.OP_FLOOR: lambda x: x.to_integral_value(ROUND_FLOOR),
    ca.OP_CEIL: lambda x: x.to_integral_value(ROUND_CEILING),
    ca.OP_FMOD: lambda x, y: x % y,
    ca.OP_REMAINDER: lambda x, y: x - y * (x / y).to_integral_value(ROUND_HALF_EVEN),
    ca.OP_COPYSIGN: _copysign,
    ca.OP_IF_ELSE_ZERO: lambda x, y: y if x else Decimal(0),
    ca.OP_FMIN: min,
    ca.OP_FMAX: max,
    ca.OP_SINH: _sinh,
    ca.OP_COSH: _cosh,
    ca.OP_TANH: lambda x: _sinh(x) / _cosh(x),
    ca.OP_ASINH: _asinh,
    ca.OP_ACOSH: lambda x: (x + (x * x - 1).sqrt()).ln(),
    ca.OP_ATANH: lambda x: ((1 + x) / (1 - x)).ln() / 2,
    ca.OP_ATAN2: _atan2,
    ca.OP_LOG1P: lambda x: (1 + x).ln(),
    ca.OP_EXPM1: lambda x: x.exp() - 1,
    ca.OP_HYPOT: lambda x, y: (x * x + y * y).sqrt(),
    ca.OP_ERF: _erf,
}
"""What CasADi's operations give; erfinv is left out."""
