"""Enclosures compared with exact rational arithmetic and with mpmath, with seeded faults."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

import casadi as ca
import mpmath
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dmframe.common.errors import ValueFault
from dmframe.exact import enclosure
from dmframe.exact.enclosure import Enclosing, Enclosure, down, up

finite = st.floats(-1e6, 1e6)
angles = st.floats(-50, 50)
shares = st.floats(0, 1)
BINARY = [operator.add, operator.sub, operator.mul, operator.truediv]


def between(low: float, high: float, share: float) -> float:
    return min(max(low + share * (high - low), low), high)


def holds(found: Enclosure, exact: Fraction) -> bool:
    lower, upper = float(found.lower), float(found.upper)
    if (lower, upper) == (-math.inf, math.inf):
        return True
    return Fraction(lower) <= exact <= Fraction(upper)


def numbers(low: float, width: float) -> tuple[float, float]:
    return low, low + width


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_the_ends_reach_the_next_numbers(x: float) -> None:
    with np.errstate(over="ignore"):
        assert down(x) <= np.nextafter(x, -np.inf)
        assert up(x) >= np.nextafter(x, np.inf)


@pytest.mark.parametrize("operation", BINARY)
@given(finite, st.floats(0, 10), finite, st.floats(0, 10), shares, shares)
@example(-0.5, 1.0, 0.0, 1.0, 0.0, 0.0)
def test_an_operation_encloses_the_exact_result(
    operation: Callable[..., object], a: float, wide: float, b: float, high: float, s: float, t: float
) -> None:
    x, y = Enclosure(*map(np.asarray, numbers(a, wide))), Enclosure(*map(np.asarray, numbers(b, high)))
    found = operation(x, y)
    assert isinstance(found, Enclosure)
    left, right = Fraction(between(a, a + wide, s)), Fraction(between(b, b + high, t))
    if operation is operator.truediv and (float(y.lower) <= 0 <= float(y.upper)):
        assert (float(found.lower), float(found.upper)) == (-math.inf, math.inf)
    else:
        assert holds(found, operation(left, right))
        assert np.isfinite(found.upper) or min(abs(y.lower), abs(y.upper)) < 1e-290


@given(finite, st.floats(0, 10), shares)
def test_a_square_encloses_the_exact_one_and_is_never_negative(a: float, wide: float, s: float) -> None:
    found = Enclosure(np.asarray(a), np.asarray(a + wide)).square()
    assert holds(found, Fraction(between(a, a + wide, s)) ** 2)
    assert found.lower >= 0


def outside(low: float, high: float, x: float) -> list[str]:
    """Whether sine and cosine of x are outside the enclosure of the angles from `low` to `high`."""
    return beyond(Enclosure(np.asarray(low), np.asarray(high)).sin_cos(), x)


def beyond(found: Sequence[Enclosure], x: float, place: Any = ()) -> list[str]:
    """Whether sine and cosine of x are outside the enclosures at a place of their arrays."""
    with mpmath.workprec(200):
        exact = (mpmath.sin(mpmath.mpf(x)), mpmath.cos(mpmath.mpf(x)))
        pairs = zip(("sin", "cos"), found, exact, strict=True)
        ends = [(name, float(e.lower[place]), float(e.upper[place]), value) for name, e, value in pairs]
        return [name for name, lower, upper, value in ends if not mpmath.mpf(lower) <= value <= mpmath.mpf(upper)]


@settings(max_examples=200)
@given(angles, st.floats(0, 8), shares)
def test_sine_and_cosine_enclose_every_value(low: float, width: float, share: float) -> None:
    assert outside(low, low + width, between(low, low + width, share)) == []


@pytest.mark.parametrize("turns", range(-9, 10))
def test_sine_and_cosine_hold_at_their_tops_and_bottoms(turns: int) -> None:
    near = turns * math.pi / 2
    for low in (near, np.nextafter(near, 9e9), np.nextafter(near, -9e9), near - 1e-9, near - 0.3):
        for x in (low, near + 1e-12, near + 0.1):
            assert outside(low, max(x, near + 0.1), x) == []


@given(angles)
def test_sine_and_cosine_of_a_number_are_sharp(x: float) -> None:
    sine, cosine = Enclosure.of(x).sin_cos()
    assert max(sine.upper - sine.lower, cosine.upper - cosine.lower) < 1e-13


def test_an_angle_too_far_away_has_the_whole_range() -> None:
    sine, cosine = Enclosure.of(1e9).sin_cos()
    assert (float(sine.lower), float(sine.upper), float(cosine.lower), float(cosine.upper)) == (-1, 1, -1, 1)


@given(st.fractions(-100, 100))
def test_a_rational_number_is_enclosed(x: Fraction) -> None:
    assert holds(Enclosure.around(x), x)


@given(angles, angles, st.floats(0, 2), shares, shares)
def test_a_function_encloses_its_values(a: float, b: float, width: float, s: float, t: float) -> None:
    x = ca.SX.sym("x", 2)
    terms = [x[0] * ca.sin(x[1]) + x[1] ** 2 / 3, -ca.cos(x[0]) / (2 + ca.sin(x[0] + x[1])) + 2 * x[1]]
    f = ca.Function("f", [x], [ca.vertcat(*terms)])
    (found,) = Enclosing(f)([[Enclosure(np.asarray(v), np.asarray(v + width)) for v in (a, b)]])
    with mpmath.workprec(200):
        u, v = (mpmath.mpf(between(z, z + width, r)) for z, r in ((a, s), (b, t)))
        third = mpmath.mpf(1) / 3
        exact = [u * mpmath.sin(v) + v * v * third, -mpmath.cos(u) / (2 + mpmath.sin(u + v)) + 2 * v]
        for e, value in zip(found, exact, strict=True):
            assert mpmath.mpf(float(e.lower)) <= value <= mpmath.mpf(float(e.upper))


def test_boxes_are_enclosed_together_as_alone() -> None:
    x = ca.SX.sym("x")
    enclosing = Enclosing(ca.Function("f", [x], [ca.sin(x) * x - 1]))
    low = np.linspace(-3, 3, 50)
    ((together,),) = enclosing([[Enclosure(low, low + 0.1)]])
    for k, begin in enumerate(low):
        ((alone,),) = enclosing([[Enclosure(begin, low[k] + 0.1)]])
        assert (together.lower[k], together.upper[k]) == (alone.lower, alone.upper)


def test_an_operation_without_an_enclosure_is_refused() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(ValueFault, match="f: expected"):
        Enclosing(ca.Function("f", [x], [ca.tanh(x)]))
    with pytest.raises(ValueFault, match="f: expected finite constants, found inf"):
        Enclosing(ca.Function("f", [x], [x + ca.inf]))


def inward() -> list[str]:
    """Result of the checks above for many angles."""
    angles = np.linspace(-20, 20, 997)
    found = Enclosure(angles, angles).sin_cos()
    return [name for place, x in enumerate(angles) for name in beyond(found, float(x), place)]


def test_an_end_that_is_rounded_inward_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    assert inward() == []
    monkeypatch.setattr(enclosure, "up", lambda x: np.nextafter(x, -np.inf))
    monkeypatch.setattr(enclosure, "down", lambda x: np.nextafter(x, np.inf))
    assert inward() != []


def test_a_series_that_is_cut_short_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(enclosure, "_SINE", enclosure._SINE[:6])
    monkeypatch.setattr(enclosure, "_COSINE", enclosure._COSINE[:6])
    assert inward() != []


def test_an_end_where_the_sine_turns_is_included(monkeypatch: pytest.MonkeyPatch) -> None:
    top = math.pi / 2
    assert outside(top - 0.3, top + 0.2, top) == []
    monkeypatch.setattr(enclosure, "_passes", lambda angle, place: np.zeros(np.shape(angle.lower), dtype=bool))
    assert outside(top - 0.3, top + 0.2, top) == ["sin"]
