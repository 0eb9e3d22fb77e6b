"""Enclosures of switching functions, compared with CasADi's values at points of the interval."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dmframe.common.errors import ValueFault
from dmframe.exact.enclosure import Enclosing, Enclosure
from dmframe.exact.switching import SWITCHING, over_pieces

X, Y = ca.SX.sym("x"), ca.SX.sym("y")
FUNCTIONS: dict[str, Any] = {
    "comparisons": ca.if_else(X < Y, X * Y, ca.if_else(X <= 0.5, Y, -X)) + (X != Y) + (X == 1),
    "logic": ca.if_else(ca.logic_and(X > 0, ca.logic_not(Y > 0)), X, ca.if_else(ca.logic_or(X > 1, Y > 1), 3, Y)),
    "ends": ca.fmin(X, Y) * ca.fmax(X, 0.3) + ca.fabs(X - Y),
    "steps": ca.floor(2 * X) + X * ca.ceil(Y) - ca.sign(X) * Y,
    "rests": ca.fmod(X, 0.7) + ca.remainder(Y, 0.4) * X + ca.fmod(Y, -0.9),
    "powers": X**3 - Y**4 + ca.sqrt(1 + X * X) + (2 + Y * Y) ** -2 + (1 + X**2) ** 0.5,
    "rising": ca.exp(X) - ca.tanh(3 * Y) + ca.exp(-1e4 * X**2),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_an_enclosure_holds_every_value_of_the_interval(name: str) -> None:
    f = ca.Function("f", [X, Y], [ca.densify(FUNCTIONS[name])])
    enclosing, rng = Enclosing(f, SWITCHING), np.random.default_rng(0)
    low = np.round(rng.uniform(-2, 2, (2, 200)), 1)
    high = low + rng.choice([0, 0.05, 0.3, 1.5], (2, 200))
    inputs = [[Enclosure(low[k], high[k])] for k in range(2)]
    (plain,), ((pieces,), _) = enclosing(inputs)[0], over_pieces(enclosing, inputs, (200,))
    for share in (0.0, 0.5, 1.0, *rng.random(20)):
        x, y = low + (high - low) * np.array([[share], [rng.choice([0, 1, share])]])
        value = f(x[None], y[None]).full().ravel()
        for found in (plain, pieces):
            assert (found.lower <= value + 1e-12).all()
            assert (value <= found.upper + 1e-12).all()
    assert np.isfinite(plain.upper - plain.lower).all()


def continuous(x: Any) -> Any:
    return ca.if_else(x < 0, 1 + x, 1 - x) + (x + 5 - ca.floor(x + 5)) * x


def test_what_is_continuous_where_it_switches_has_a_narrow_range_there_and_a_jump_is_reported() -> None:
    f = Enclosing(ca.Function("f", [X], [continuous(X)]), SWITCHING)
    inputs = [[Enclosure(np.array([-1e-9, 0.2]), np.array([1e-9, 0.3]))]]
    (found,), jumps = over_pieces(f, inputs, (2,))
    assert found.upper[0] - found.lower[0] < 1e-7
    assert jumps.tolist() == [True, False]
    (wide,) = f(inputs)[0]
    assert wide.upper[0] - wide.lower[0] > 0.9  # the reason for the pieces


@pytest.mark.parametrize(
    "jump", [lambda x: ca.floor(x), lambda x: ca.sign(x), lambda x: x > 0, lambda x: ca.fmod(1 + x, 1)]
)
def test_no_jump_is_overlooked(jump: Callable[[Any], Any]) -> None:
    f = Enclosing(ca.Function("f", [X], [jump(X) + X]), SWITCHING)
    (found,), jumps = over_pieces(f, [[Enclosure(np.array([-1e-9]), np.array([1e-9]))]], (1,))
    assert jumps.all()
    assert found.upper[0] - found.lower[0] > 0.9


def test_an_operation_without_an_enclosure_is_refused_by_name() -> None:
    with pytest.raises(ValueFault, match="f: expected operations with an enclosure rule, found log"):
        Enclosing(ca.Function("f", [X], [ca.log(X)]), SWITCHING)
    power = Enclosing(ca.Function("f", [X, Y], [X**Y]), SWITCHING)
    with pytest.raises(ValueFault, match="found pow"):
        power([[Enclosure.of(2.0)], [Enclosure(np.array(0.3), np.array(0.4))]])
