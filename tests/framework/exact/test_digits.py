"""Sixty digits against mpmath, which has its own algorithms."""

from __future__ import annotations

import math
from decimal import Decimal
from typing import Any

import casadi as ca
import mpmath
import pytest

from dmframe.exact import Tape
from dmframe.exact.digits import UndefinedHere, at_point

x, y = ca.SX.sym("x"), ca.SX.sym("y")
FUNCTIONS = (
    "sin cos tan asin acos atan sinh cosh tanh asinh atanh log1p expm1 erf exp sqrt log acosh".split()
)  # fmt: skip


def value_of(e: Any, a: str, b: str = "1") -> Decimal:
    [[found]] = at_point(Tape.from_function(ca.Function("f", [x, y], [e])), [[Decimal(a)], [Decimal(b)]])
    return found


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("at", ["0.3", "0.0012", "-0.77", "1.9", "37.25"])
def test_functions_agree_with_mpmath_to_fifty_digits(name: str, at: str) -> None:
    e = getattr(ca, name)(x)
    with mpmath.workdps(80):
        reference = getattr(mpmath, {"log": "ln"}.get(name, name))(mpmath.mpf(at))
        if isinstance(reference, mpmath.mpc) or (name == "erf" and at == "37.25"):
            with pytest.raises(UndefinedHere):
                value_of(e, at)
            return
        assert abs(mpmath.mpf(str(value_of(e, at))) / reference - 1) < mpmath.mpf("1e-50")


@pytest.mark.parametrize("at", ["139.9", "140.1", "-3e18", "1e99"])
def test_a_large_argument_of_tanh_is_no_overflow(at: str) -> None:
    with mpmath.workdps(200):
        reference = mpmath.tanh(mpmath.mpf(at))
    assert abs(mpmath.mpf(str(value_of(ca.tanh(x), at))) - reference) < mpmath.mpf("1e-69")


@pytest.mark.parametrize(("a", "b"), [("0.4", "-1.3"), ("-0.4", "-1.3"), ("2", "0.5"), ("-7.5", "2"), ("1", "0.25")])
def test_functions_of_two_arguments_agree_with_the_mathematics_library(a: str, b: str) -> None:
    p, q = float(a), float(b)
    known = {
        ca.atan2(x, y): math.atan2(p, q),
        ca.fmod(x, y): math.fmod(p, q),
        ca.remainder(x, y): math.remainder(p, q),
        ca.copysign(x, y): math.copysign(p, q),
        ca.hypot(x, y): math.hypot(p, q),
        ca.fmin(x, y): min(p, q),
        ca.fmax(x, y): max(p, q),
        ca.if_else(x < y, x, 3 * y): p if p < q else 3 * q,
        ca.floor(x) + ca.ceil(y) + ca.sign(x): math.floor(p) + math.ceil(q) + math.copysign(1, p),
        x**2 / y + ca.fabs(x): p**2 / q + abs(p),
    }
    for e, reference in known.items():
        assert float(value_of(e, a, b)) == pytest.approx(reference, abs=1e-15)


@pytest.mark.parametrize("e", [ca.sqrt(x), x**1.5, ca.log(x), 1 / (x + 1), ca.acos(2 * x), ca.exp(-1e30 * x)])
def test_where_there_is_no_real_value_it_says_so(e: Any) -> None:
    with pytest.raises(UndefinedHere):
        value_of(e, "-1")
