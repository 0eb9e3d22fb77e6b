"""Directional derivatives in the field equal CasADi's, operation by operation and in whole programs."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from typing import Any, Final

import casadi as ca
import pytest

from dmframe.exact import Tape, Trial, random_prime
from dmframe.exact.tangent import Tangents
from dmframe.program import OPERATIONS

WRITTEN: Final[Mapping[str, Callable[..., Any]]] = {
    "add": lambda x, y: x + y,
    "sub": lambda x, y: x - y,
    "mul": lambda x, y: x * y,
    "div": lambda x, y: x / y,
    "neg": lambda x: -x,
    "inv": lambda x: 1 / x,
    "sq": lambda x: x * x,
    "twice": lambda x: x + x,
    "pow": lambda x, y: x**y,
    "constpow": lambda x, y: x**1.5 + x**2.5 + x**-3,
    "lt": lambda x, y: x < y,
    "le": lambda x, y: x <= y,
    "eq": lambda x, y: x == y,
    "ne": lambda x, y: x != y,
    "not": ca.logic_not,
    "and": ca.logic_and,
    "or": ca.logic_or,
    "if_else_zero": lambda x, y: ca.if_else(x, y, 0),
}
"""Operations that are not functions of CasADi's module."""

X, Y, DX, DY = (ca.SX.sym(name) for name in ("x", "y", "dx", "dy"))


def both(expression: ca.SX, seed: int = 1) -> tuple[int, int]:
    """The derivative along (dx, dy) at a random point: ours, and that of CasADi's expression."""
    function = ca.Function("f", [X, Y], [expression])
    written = ca.jtimes(expression, ca.vertcat(X, Y), ca.vertcat(DX, DY))
    rng = random.Random(seed)
    trial = Trial(random_prime(rng), rng)
    point = [[trial.random()] for _ in range(4)]
    tape = Tape.from_function(function)
    values = tape.values(point[:2], trial)
    ours = Tangents(tape, [0], [0, 1]).along(trial, values, {0: point[2], 1: point[3]})[0][0] % trial.prime
    return ours, Tape.from_function(ca.Function("df", [X, Y, DX, DY], [written])).evaluate(point, trial)[0][0]


@pytest.mark.parametrize("operation", list(OPERATIONS.values()), ids=lambda row: row.name)
def test_each_operation_has_casadis_derivative(operation: Any) -> None:
    make = WRITTEN.get(operation.name) or getattr(ca, operation.name)
    ours, casadis = both(make(X, Y) if operation.arity == 2 else make(X))
    assert ours == casadis


def test_a_program_has_casadis_derivative_and_another_one_not() -> None:
    expression = ca.sin(X * Y) ** 2 / (1 + X**2) - ca.tanh(Y) * ca.sqrt(1 + X**2) + ca.fmax(X, Y) * ca.fabs(X - Y)
    ours, casadis = both(expression)
    assert ours == casadis != 0
    assert both(expression + X)[0] != casadis


def test_what_nothing_moves_has_no_derivative() -> None:
    tape = Tape.from_function(ca.Function("f", [X, Y], [ca.sin(Y), X * Y]))
    rng = random.Random(2)
    trial = Trial(random_prime(rng), rng)
    point = [[trial.random()], [trial.random()]]
    still, moving = Tangents(tape, [0, 1], [0]).along(trial, tape.values(point, trial), {0: [1]})
    assert still == [0]
    assert moving == point[1]
