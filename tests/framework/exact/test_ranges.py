"""Ranges over intervals compared with values at many points, and the two methods, each sharper in some cases."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dmframe.common.errors import ValueFault
from dmframe.exact import ranges as module
from dmframe.exact.balls import UndecidedError
from dmframe.exact.enclosure import Enclosure
from dmframe.exact.ranges import ranges
from dmframe.exact.rational import Interval, evaluate, known_values
from dmframe.program import TO_READ, read

x, y = ca.SX.sym("x"), ca.SX.sym("y")
Given = Fraction | Interval


def over(e: Any, *inputs: Given) -> list[Interval]:
    return ranges(read(ca.Function("f", [x, y][: len(inputs)], [e])), [[value] for value in inputs])


def between(low: float, high: float) -> Interval:
    return Interval(Fraction(str(low)), Fraction(str(high)))


FUNCTIONS: dict[str, Any] = {
    "products": x * y - x**2 * y + x / (2 + y * y),
    "functions": ca.sin(x) * ca.exp(-y) + ca.tanh(x * y) - ca.sqrt(1 + x * x),
    "switches": ca.if_else(x < y, ca.fabs(x), ca.fmax(y, 0.3)) + ca.sign(y) * ca.floor(x),
    "others": ca.log(3 + x) + ca.atan(y) + ca.cosh(x),
}


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("width", [0.0, 0.4, 1.9])
def test_a_range_has_every_value(name: str, width: float) -> None:
    f, random = ca.Function("f", [x, y], [FUNCTIONS[name]]), np.random.default_rng(1)
    if name == "others" and width:
        (found,) = over(FUNCTIONS[name], between(-0.8, width), between(-0.5, 0.5))
        low, high = np.array([-0.8, -0.5]), np.array([width, 0.5])
    else:
        low, high = np.array([-0.75, -0.9]), np.array([-0.75, -0.9]) + width
        (found,) = over(FUNCTIONS[name], *(between(a, round(b, 3)) for a, b in zip(low, high, strict=True)))
    for share in (np.zeros(2), np.ones(2), *random.random((200, 2))):
        value = float(f(*(low + share * (high - low))))
        assert found.lower - Fraction(1, 10**12) <= value <= found.upper + Fraction(1, 10**12)
    assert (found.upper - found.lower < Fraction(1, 10**15)) is (width == 0)


def test_ends_are_sharp_and_terms_that_cancel_lose_nothing() -> None:
    (root,) = over(ca.sqrt(x), between(0, 0.3))
    assert root.lower == 0  # a ball of this interval contains negative numbers
    wide = ca.sqrt(1e32 + x * x) - 1e16
    (difference,) = over(wide, between(1, 2))
    assert 0 < difference.lower < Fraction(1, 10**16) < difference.upper < Fraction(3, 10**16)
    (point,) = over(wide, Fraction(1))
    assert point.lower <= Fraction(1, 2 * 10**16) <= point.upper


@pytest.mark.parametrize(
    ("way", "e", "at"),
    [("_in_floats", ca.sqrt(x), between(0, 0.3)), ("_in_balls", ca.sqrt(1e32 + x * x) - 1e16, between(1, 2))],
)
def test_neither_way_can_be_left_out(way: str, e: Any, at: Given, monkeypatch: pytest.MonkeyPatch) -> None:
    (whole,) = over(e, at)
    other = {"_in_floats": "_in_balls", "_in_balls": "_in_floats"}[way]
    monkeypatch.setattr(module, way, getattr(module, other))
    try:
        (less,) = over(e, at)
    except UndecidedError:
        return
    assert less.lower < whole.lower


def test_a_box_that_omits_its_width_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def misses() -> bool:
        (found,) = over(x * x, between(1, 2))
        return not (found.lower <= 1 and found.upper >= 4)

    assert not misses()
    monkeypatch.setattr(module, "_box", lambda value: Enclosure.around(value.lower))
    assert misses()


@pytest.mark.parametrize("e", [ca.log(x), 1 / x, ca.exp(1e300 + 0 * x), ca.erfinv(x), ca.exp(ca.exp(800 + x))])
def test_what_has_no_range_is_refused(e: Any) -> None:
    with pytest.raises(UndecidedError):
        over(e, between(-0.5, 0.5))


@pytest.mark.parametrize("given", [Fraction(-1, 3), between(-0.5, 2.0), Fraction(0)])
def test_each_value_is_that_of_its_own_evaluation_and_none_where_that_fails(given: Given) -> None:
    free = ca.SX.sym("free")
    column = ca.vertcat(x * x + 2, 1 / x, x / y - x, ca.sin(x), y + free, y, y + ca.sin(x))
    found = known_values(
        read(ca.Function("f", [x, y], [column], {"allow_free": True, **TO_READ})), [[given], [Fraction(2)]]
    )
    alone = list[Any]()
    for element in ca.vertsplit(column):
        try:
            alone.append(evaluate(ca.Function("f", [x, y], [element]), [[given], [Fraction(2)]])[0][0])
        except (ValueFault, ZeroDivisionError, RuntimeError):  # CasADi refuses a free symbol
            alone.append(None)
    assert found == alone
    assert found.count(None) == (3 if given == Fraction(-1, 3) else 4)
