"""A scalar CasADi expression as LaTeX, in the structure in which it was written."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any, Final

import casadi as ca

from dmframe.certificate import SX

_SUM, _SIGNED, _PRODUCT, _POWER, _ATOM = range(5)
"""How tightly a piece of LaTeX holds together."""

Names = Callable[[SX], str]
"""The LaTeX of a symbol."""

_FUNCTIONS: Final = {ca.OP_SIN: r"\sin", ca.OP_COS: r"\cos", ca.OP_TANH: r"\tanh", ca.OP_SIGN: r"\operatorname{sgn}"}


def expression_latex(expression: SX, names: Names) -> str | None:
    """The expression, with its symbols named; None where it holds an operation that has no sign in print here."""
    try:
        return _written(expression, names)[0]
    except LookupError:
        return None


def _written(x: SX, names: Names) -> tuple[str, int]:
    if x.is_constant():
        return _number(float(x))
    if x.is_symbolic():
        return names(x), _ATOM
    parts = [x.dep(i) for i in range(x.n_dep())]
    kind = x.op()
    if kind in _FUNCTIONS:
        return rf"{_FUNCTIONS[kind]}\left({_written(parts[0], names)[0]}\right)", _POWER
    return _WRITERS[kind](parts, names)


def _number(value: float) -> tuple[str, int]:
    exact = Fraction(value).limit_denominator(10**6)
    if float(exact) != value:
        return f"{value:.6g}", _ATOM if value >= 0 else _SIGNED
    if exact.denominator == 1:
        return str(exact), _ATOM if exact >= 0 else _SIGNED
    return (
        rf"{'-' * (exact < 0)}\tfrac{{{abs(exact.numerator)}}}{{{exact.denominator}}}",
        _ATOM if exact > 0 else _SIGNED,
    )


def _held(x: SX, names: Names, least: int) -> str:
    """In brackets where it holds together less than `least`."""
    text, holds = _written(x, names)
    return text if holds >= least else rf"\left({text}\right)"


def _add(parts: list[SX], names: Names) -> tuple[str, int]:
    left, right = _held(parts[0], names, _SUM), _held(parts[1], names, _SUM)
    return f"{left} - {right[1:].lstrip()}" if right.startswith("-") else f"{left} + {right}", _SUM


def _subtract(parts: list[SX], names: Names) -> tuple[str, int]:
    return f"{_held(parts[0], names, _SUM)} - {_held(parts[1], names, _PRODUCT)}", _SUM


def _multiply(parts: list[SX], names: Names) -> tuple[str, int]:
    left, right = _held(parts[0], names, _PRODUCT), _held(parts[1], names, _PRODUCT)
    if right[:1].isdigit():
        left, right = right, left
    return f"{left} {right}", _PRODUCT


def _divide(parts: list[SX], names: Names) -> tuple[str, int]:
    return rf"\frac{{{_written(parts[0], names)[0]}}}{{{_written(parts[1], names)[0]}}}", _POWER


def _square(parts: list[SX], names: Names) -> tuple[str, int]:
    return f"{_held(parts[0], names, _ATOM)}^2", _POWER


def _inverse(parts: list[SX], names: Names) -> tuple[str, int]:
    return rf"\frac{{1}}{{{_written(parts[0], names)[0]}}}", _POWER


def _negate(parts: list[SX], names: Names) -> tuple[str, int]:
    return f"-{_held(parts[0], names, _PRODUCT)}", _SIGNED


def _twice(parts: list[SX], names: Names) -> tuple[str, int]:
    return f"2 {_held(parts[0], names, _PRODUCT)}", _PRODUCT


_WRITERS: Final[dict[int, Callable[[list[Any], Names], tuple[str, int]]]] = {
    ca.OP_ADD: _add,
    ca.OP_SUB: _subtract,
    ca.OP_MUL: _multiply,
    ca.OP_DIV: _divide,
    ca.OP_SQ: _square,
    ca.OP_INV: _inverse,
    ca.OP_NEG: _negate,
    ca.OP_TWICE: _twice,
}
