"""Ball arithmetic compared with mpmath, SciPy and exact fractions, with seeded faults."""

from __future__ import annotations

import math
import threading
from fractions import Fraction
from typing import Any

import casadi as ca
import mpmath
import numpy as np
import pytest
import scipy
from flint import arb, arb_mat, ctx, fmpq
from hypothesis import given
from hypothesis import strategies as st

from dmframe.exact import balls
from dmframe.exact.ball_matrix import exactly, middles, positive_definite, radii, scaled, transition
from dmframe.exact.balls import BITS, RULES, UndecidedError, above, ball, below, enclosed, precise
from dmframe.exact.literal import literal
from dmframe.program import by_code, read

numbers = st.floats(-1e3, 1e3)
x, y = ca.SX.sym("x"), ca.SX.sym("y")
FUNCTIONS = "sin cos tan asin acos atan sinh cosh tanh asinh atanh log1p expm1 erf exp sqrt log acosh fabs".split()
WIDTH = 1e-60


def fraction(value: arb) -> Fraction:
    """An exact ball."""
    exact = value.fmpq()
    return Fraction(int(exact.p), int(exact.q))


def holds(found: arb, value: Any) -> bool:
    """`value` is a fraction, or a number of mpmath with more bits than the ball."""
    with ctx.workprec(4000):
        if isinstance(value, Fraction):
            return fmpq(value.numerator, value.denominator) in found
        return arb(value) in found


def number(value: float) -> Any:
    exact = literal(value)
    return mpmath.mpf(exact.numerator) / exact.denominator


def values(e: Any, *inputs: arb) -> list[arb]:
    program = read(ca.Function("f", [x, y][: len(inputs)], [e]))
    return program.dense(enclosed(program, [[value] for value in inputs]), arb(0))[0]


@given(numbers, numbers)
@precise()
def test_sums_products_and_quotients_hold_the_exact_ones(a: float, b: float) -> None:
    one, other = literal(a), literal(b)
    p, q = ball(a), ball(b)
    for found, exact in ((p + q, one + other), (p - q, one - other), (p * q, one * other)):
        assert holds(found, exact)
    if other:
        assert holds(p / q, one / other)
        assert (p / q).rad() <= abs(p / q) * 2.0 ** (4 - BITS)


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("at", [0.3, 0.0012, -0.77, 1.9, 37.25, -680.0, 1e99])
def test_functions_hold_what_mpmath_states_and_nothing_where_it_is_not_real(name: str, at: float) -> None:
    e = getattr(ca, name)(x)
    with mpmath.workprec(2000):
        point = number(at)
        reference = getattr(mpmath, {"log": "ln"}.get(name, name))(point)
        if isinstance(reference, mpmath.mpc):
            with pytest.raises(UndecidedError, match=f"the operand of {name} may be outside its domain"):
                values(e, ball(at))
            return
        if name in ("sin", "cos", "tan") and at > 1e90:
            return  # the ball of 1e99 is as wide as a period
        (found,) = values(e, ball(at))
        assert holds(found, reference)
        assert found.rad() <= WIDTH * max(abs(reference), 1)


@pytest.mark.parametrize("name", ["exp", "sin", "tanh", "sqrt", "mul", "div"])
def test_a_rule_that_omits_its_radius_is_found_out(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    e = {"mul": ca.exp(x) * x, "div": x / ca.exp(x)}[name] if name in ("mul", "div") else getattr(ca, name)(x)
    (code,) = by_code({name: None})
    with mpmath.workprec(2000):
        point = mpmath.mpf(0.3)
        product = {"mul": point * mpmath.exp(point), "div": point / mpmath.exp(point)}
        wanted = product.get(name) or getattr(mpmath, name)(point)
        assert holds(values(e, arb(0.3))[0], wanted)
        rule = RULES[code]
        monkeypatch.setitem(RULES, code, lambda *operands: rule(*operands).mid())
        assert not holds(values(e, arb(0.3))[0], wanted)


def test_more_bits_give_narrower_balls() -> None:
    e, at = ca.sin(1e40 * x), ball(0.3)
    widths = [float(value.rad()) for bits in (64, 256, 1024) for value in enclosed_in(e, ball(0.3, bits), bits)]
    assert widths[0] >= 1 > widths[1] > 1e-80 > 1e-200 > widths[2]
    assert holds(ball(0.3, 1024), Fraction(3, 10))
    assert at.rad() > ball(0.3, 1024).rad()


def enclosed_in(e: Any, value: arb, bits: int) -> list[arb]:
    program = read(ca.Function("f", [x], [e]))
    return program.stored(enclosed(program, [[value]], bits=bits))[0]


def test_a_literal_that_omits_its_radius_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    assert holds(ball(0.3), Fraction(3, 10))
    rational = balls._rational
    monkeypatch.setattr(balls, "_rational", lambda *given: rational(*given).mid())
    assert not holds(ball.__wrapped__(0.3), Fraction(3, 10))


@pytest.mark.parametrize(("a", "b"), [(0.4, -1.3), (-0.4, -1.3), (2, 0.5), (-7.5, 2), (1, 0.25)])
def test_functions_of_two_arguments_agree_with_the_mathematics_library(a: float, b: float) -> None:
    known = {
        ca.atan2(x, y): math.atan2(a, b),
        ca.fmod(x, y): math.fmod(a, b),
        ca.remainder(x, y): math.remainder(a, b),
        ca.copysign(x, y): math.copysign(a, b),
        ca.hypot(x, y): math.hypot(a, b),
        ca.fmin(x, y): min(a, b),
        ca.fmax(x, y): max(a, b),
        ca.if_else(x < y, x, 3 * y): a if a < b else 3 * b,
        ca.floor(x) + ca.ceil(y) + ca.sign(x): math.floor(a) + math.ceil(b) + math.copysign(1, a),
        x**2 / y + ca.fabs(x): a**2 / b + abs(a),
    }
    for e, reference in known.items():
        assert float(values(e, arb(a), arb(b))[0]) == pytest.approx(reference, abs=1e-15)


def test_a_ball_around_an_edge_has_all_values_of_its_function() -> None:
    around = arb(1.6, 0.1)  # pi/2 lies in it
    assert values(ca.sin(x), around)[0].contains(arb(1))
    (found,) = values(ca.cos(x), around)
    assert all(found.contains(arb(value).cos()) for value in (1.5, 1.6, 1.7))
    zero = arb(0, 1)
    for e, ends in ((x * x, (0, 1)), (x**3, (-1, 1)), (x**4, (0, 1)), (ca.fabs(x), (0, 1)), (ca.hypot(x, x), (0, 1))):
        (found,) = values(e, zero)
        assert all(found.contains(end) for end in ends)
        assert found >= 0 or ends[0] < 0
    assert values(ca.fmax(x, 0.5), zero)[0].contains(0.5)


@pytest.mark.parametrize(
    ("e", "reason"),
    [
        (1 / x, "a divisor may be zero"),
        (y / x, "a divisor may be zero"),
        (ca.sqrt(x), "the operand of sqrt may be outside its domain"),
        (x**1.5, "the operand of constpow may be outside its domain"),
        (ca.if_else(x > 0, 1, 2), "a comparison cannot be decided"),
        ((x < 0) * y, "a comparison cannot be decided"),
        (1 / (x < 0), "a comparison cannot be decided"),
        (ca.sign(x), "a comparison cannot be decided"),
        (ca.floor(x), "a comparison cannot be decided"),
        (ca.fmod(y - x, 1), "a comparison cannot be decided"),
        (ca.remainder(x + 0.5, y), "a comparison cannot be decided"),
        (ca.copysign(y, x), "a comparison cannot be decided"),
        (ca.atan2(x, -y), "a comparison cannot be decided"),
    ],
)
def test_what_cannot_be_decided_is_refused(e: Any, reason: str) -> None:
    with pytest.raises(UndecidedError, match=f"^{reason}$"):
        values(e, arb(0, 1e-60), arb(1))


def test_logic_is_decided_by_what_is_known() -> None:
    e = ca.vertcat(ca.logic_and(x > 0, x > 1), ca.logic_or(x > 0, x < 1), x > 0, x == 0, x != 2, ca.logic_not(x - 3))
    found = values(e, arb(0, 1e-60))
    assert [None if value.is_nan() else int(float(value)) for value in found] == [0, 1, None, None, 1, 0]
    exact = values(ca.vertcat(x == 1, x != 1, x <= 1, x < 1, ca.logic_not(x - 1)), arb(1))
    assert [int(float(value)) for value in exact] == [1, 0, 1, 0, 1]


def test_a_number_that_is_invalid_is_refused_and_so_is_a_function_that_is_not_written_out() -> None:
    with pytest.raises(UndecidedError, match="a number is not finite"):
        values(x, arb.nan())
    inner = ca.Function("inner", [x], [x * x], {"never_inline": True})
    for e in (inner(x), ca.erfinv(x)):  # CasADi's erfinv has an error of 4e-8
        with pytest.raises(UndecidedError, match=r"CasADi's instruction \d+ has no enclosure rule"):
            values(e, arb(0.5))


@given(st.floats(-1e300, 1e300), st.floats(0, 1e3))
def test_floats_about_a_ball_are_outside_of_it(middle: float, radius: float) -> None:
    found = arb(middle, radius)
    assert arb(below(found)) <= found.lower()
    assert arb(above(found)) >= found.upper()
    assert arb(math.nextafter(below(found), math.inf)) >= found.lower()
    assert arb(math.nextafter(above(found), -math.inf)) <= found.upper()
    assert (below(arb(middle)), above(arb(middle))) == (middle, middle)


def test_the_ends_of_numbers_too_large_for_floats_and_of_none_are_no_bounds_that_fail() -> None:
    large = arb(10) ** 400
    assert (below(large), above(large)) == (math.nextafter(math.inf, 0), math.inf)
    assert math.isnan(below(arb.nan()))
    assert below(1 / large) <= 0.0 < above(1 / large)


def test_the_precision_of_others_is_left_as_it_was_and_theirs_makes_no_result_wrong() -> None:
    before, found = ctx.prec, list[arb]()
    with precise():
        other = threading.Thread(target=lambda: found.extend(values(ca.exp(x), ball(0.3))))
        other.start()
        other.join(0.05)
        assert not found  # it waits for the lock
    other.join()
    assert ctx.prec == before
    coarse = arb(fmpq(3, 10)).exp()  # of 53 bits
    with mpmath.workprec(600):
        assert holds(found[0], mpmath.exp(number(0.3)))
        assert holds(coarse, mpmath.exp(number(0.3)))
    assert found[0].rad() < WIDTH < coarse.rad()


def stiff(size: int) -> np.ndarray:
    random = np.random.default_rng(4)
    root = random.normal(size=(size, size))
    return np.asarray(np.round(random.normal(size=(size, size)) - 300 * root @ root.T, 3))


def decimals(A: np.ndarray) -> arb_mat:
    return arb_mat([[ball(float(value)) for value in row] for row in A])


@pytest.mark.parametrize("time", [0.002, 0.5])
def test_the_transition_of_a_held_system_is_mpmaths_to_fifty_digits(time: float) -> None:
    A = stiff(5)
    found = transition(decimals(A), ball(time))
    with mpmath.workprec(3000):
        exact = mpmath.matrix([[number(float(value)) for value in row] for row in A])
        t = number(time)
        wanted = mpmath.expm(exact * t)
        for matrix, mp in zip(found, (wanted, mpmath.inverse(exact) * (wanted - mpmath.eye(5))), strict=True):
            assert all(holds(matrix[i, j], mp[i, j]) for i, j in np.ndindex(5, 5))
            assert np.max(radii(matrix)) < 1e-50
            assert not any(holds(matrix[i, j].mid(), mp[i, j]) for i, j in np.ndindex(5, 5))  # an omitted radius
    np.testing.assert_allclose(middles(found[0]), scipy.linalg.expm(A * time), atol=1e-12)


def test_a_transition_keeps_its_zeros_and_an_empty_one_is_empty() -> None:
    A = np.diag([-1.0, -2.0, -3.0]) + np.diag([1.0, 0.0], 1)
    for matrix in transition(exactly(A), ball(0.1)):
        zeros = {(i, j) for i, j in np.ndindex(3, 3) if matrix[i, j].is_zero()}
        assert zeros == {(1, 0), (2, 0), (0, 2), (2, 1), (1, 2)}
    assert transition(arb_mat(0, 0), ball(0.1))[0].nrows() == 0


def test_definiteness_is_that_of_the_worst_matrix_inside() -> None:
    wide = exactly([[2.0, 1.0], [1.0, 1.0]])
    assert positive_definite(wide)
    wide[1, 1] = arb(1, 0.5)  # 2 * 1/2 = 1 * 1: singular at the lower end
    assert not positive_definite(wide)
    assert not positive_definite(exactly([[1.0, 1.0], [1.0, 1.0]]))
    assert not positive_definite(exactly([[1.0, math.nan], [math.nan, 1.0]]))
    random = np.random.default_rng(1)
    for _ in range(20):
        S = random.normal(size=(6, 6))
        S = S + S.T + random.uniform(0, 6) * np.eye(6)
        assert positive_definite(exactly(S)) == bool(np.all(np.linalg.eigvalsh(S) > 0))


def test_matrices_are_scaled_exactly_and_multiplied_within_their_radii() -> None:
    random = np.random.default_rng(2)
    a, b = random.normal(size=(3, 4)), random.normal(size=(4, 2))
    with precise():
        product = scaled(exactly(a) * exactly(b), [3, -2, 0], [1, -300])
    np.testing.assert_allclose(middles(product), np.diag([8, 0.25, 1]) @ a @ b @ np.diag([2, 2.0**-300]), atol=1e-14)
    exact = sum((Fraction(float(x)) * Fraction(float(y)) for x, y in zip(a[1], b[:, 0], strict=True)), Fraction(0)) / 2
    assert holds(product[1, 0], exact)
    assert np.all(radii(product) < WIDTH)
    assert math.isinf(middles(arb_mat([[arb(10) ** 400]]))[0, 0])


def test_an_interior_holds_nothing_that_is_not_a_number() -> None:
    """The equilibrium test of `dmframe.analysis.enclosed` relies on it."""
    assert arb(0, 1).contains_interior(arb(0, 0.5))
    assert not arb(0, 1).contains_interior(arb(0, 1))
    assert not arb(0, 1).contains_interior(arb.nan())
