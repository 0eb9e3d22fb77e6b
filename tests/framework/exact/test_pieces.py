from __future__ import annotations

from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dmframe.exact import Tape
from dmframe.exact.pieces import INSTANTS, Course, NotFollowed, follow

t = ca.SX.sym("t")


def rate(e: Any) -> Any:
    return ca.jtimes(e, t, ca.SX(1))


def course(e: Any) -> Course:
    return follow(Tape.from_function(ca.Function("f", [t], [e])), [])


TAU = ca.fmin(ca.fmax((t - 0.1) / 2, 0), 1)
LEAST_JERK = TAU**3 * (10 + TAU * (6 * TAU - 15))
TRIANGLE = ca.fabs(ca.fmod(t, 2) - 1)

CONTINUOUS = {
    "a quintic between two points": (LEAST_JERK, ["1/10", "21/10"]),
    "its velocity": (rate(LEAST_JERK), ["1/10", "21/10"]),
    "its acceleration": (rate(rate(LEAST_JERK)), ["1/10", "21/10"]),
    "a ramp that ends": (ca.fmin(t, 3), ["3"]),
    "an if_else whose branches meet": (ca.if_else(t < 1, t, 2 - t), ["1"]),
    "a sine that stops where its slope is not zero": (ca.if_else(t < 1, ca.sin(t), ca.sin(1)), ["1"]),
    "a kink times a sine": (ca.sin(t) * ca.fmax(t - 1, 0), ["1"]),
    "a kink inside a kink": (ca.fabs(ca.fabs(t - 2) - 1), ["1", "2", "3"]),
    "no switch": (ca.sin(3 * t) ** 2, []),
}
JUMPING = {
    "the third derivative of the quintic": (rate(rate(rate(LEAST_JERK))), "1/10", 0.0, 7.5),
    "the velocity of a triangle": (rate(TRIANGLE), "1", -1.0, 1.0),
    "stairs": (ca.floor(t / 3), "3", 0.0, 1.0),
    "stairs that go down": (ca.ceil(2 - t), "1", 2.0, 1.0),
    "a sawtooth": (ca.fmod(t, 2), "2", 2.0, 0.0),
    "a sawtooth about zero": (ca.remainder(t, 2), "1", 1.0, -1.0),
    "an if_else whose branches do not meet": (ca.if_else(t < 1, t, 3 - t), "1", 1.0, 2.0),
    "an if_else that is off by little": (ca.if_else(t < 1, t, 2 - t + 1e-9), "1", 1.0, 1.0 + 1e-9),
    "a sign": (ca.sign(t - 4), "4", -1.0, 1.0),
    "copysign": (ca.copysign(t, t - 5), "5", -5.0, 5.0),
    "two conditions": (ca.logic_and(t > 2, t < 7), "2", 0.0, 1.0),
}


@pytest.mark.parametrize("name", CONTINUOUS)
def test_what_is_continuous_is_seen_to_be_at_each_switching_instant(name: str) -> None:
    e, instants = CONTINUOUS[name]
    found = course(e)
    assert found.jump is None
    assert found.until is None
    assert found.instants == tuple(Fraction(text) for text in instants)


@pytest.mark.parametrize("name", JUMPING)
def test_a_jump_is_reported_with_its_instant_and_both_sides(name: str) -> None:
    e, instant, before, after = JUMPING[name]
    jump = course(e).jump
    assert jump is not None
    assert jump.time == Fraction(instant)
    assert (float(jump.before), float(jump.after)) == pytest.approx((before, after), abs=1e-15)
    f = ca.Function("f", [t], [e])  # CasADi's own evaluation on both sides
    assert float(f(float(jump.time) - 1e-9)) == pytest.approx(before, abs=1e-6)
    assert float(f(float(jump.time) + 1e-9)) == pytest.approx(after, abs=1e-6)


def test_what_switches_for_ever_is_left_after_so_many_instants() -> None:
    found = course(TRIANGLE)
    assert found.jump is None
    assert len(found.instants) == INSTANTS
    assert found.until == INSTANTS + 1
    values = ca.Function("f", [t], [TRIANGLE])
    assert np.allclose([float(values(k)) for k in range(6)], [1, 0, 1, 0, 1, 0])


@pytest.mark.parametrize("e", [ca.sign(ca.sin(t)), ca.fmin(t * t, 2), ca.fmod(t, 1 + t)])
def test_a_switch_at_the_roots_of_anything_else_is_not_followed(e: Any) -> None:
    with pytest.raises(NotFollowed):
        course(e)


def test_a_moving_divisor_or_root_is_reported() -> None:
    assert course(ca.fmin(t, 1) / (1 + t * t)).edged
    assert course(ca.asin(ca.sin(t)) + ca.fmin(t, 1)).edged
    assert not course(rate(LEAST_JERK)).edged  # its divisors are numbers between the instants
