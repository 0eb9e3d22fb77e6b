"""Enclosures of many places against mpmath, SciPy and exact fractions, and seeded faults that these catch."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import casadi as ca
import mpmath
import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st

from dmframe.exact.fixed import MAYBE, ONE, PLACES, Fixed, UndecidedError, fixed_values
from dmframe.exact.literal import literal
from dmframe.exact.matrix import Matrix, held
from dmframe.program import read

numbers = st.floats(-1e3, 1e3)


def holds(found: Fixed, value: Any) -> bool:
    """`value` is mpmath's, of more places."""
    scaled = value * mpmath.mpf(2) ** PLACES
    return bool(found.lower <= scaled <= found.upper)


@given(numbers, numbers, numbers, numbers)
def test_sums_products_and_quotients_hold_the_exact_ones(a: float, b: float, c: float, d: float) -> None:
    (low, high), (left, right) = sorted((a, b)), sorted((c, d))
    x = Fixed(Fixed.around(Fraction(low)).lower, Fixed.around(Fraction(high)).upper)
    y = Fixed(Fixed.around(Fraction(left)).lower, Fixed.around(Fraction(right)).upper)
    for first in (low, high):
        for last in (left, right):
            one, other = Fraction(first), Fraction(last)
            for found, exact in ((x + y, one + other), (x - y, one - other), (x * y, one * other)):
                assert Fraction(found.lower, ONE) <= exact <= Fraction(found.upper, ONE)
            if y.lower > 0 or y.upper < 0:
                assert Fraction((x / y).lower, ONE) <= one / other <= Fraction((x / y).upper, ONE)


@given(st.floats(-700, 700))
def test_functions_hold_what_mpmath_says(value: float) -> None:
    with mpmath.workprec(2000):
        x, point = Fixed.around(value), number(value)
        sine, cosine = x.sin_cos()
        for found, wanted in (
            (sine, mpmath.sin(point)),
            (cosine, mpmath.cos(point)),
            (x.tanh(), mpmath.tanh(point)),
            (x.exp(), mpmath.exp(point)),
            (x.absolute().sqrt(), mpmath.sqrt(abs(point))),
        ):
            assert holds(found, wanted)
        assert max(sine.width, cosine.width, x.tanh().width) < 1e-60


def test_a_wide_number_has_all_values_of_its_functions() -> None:
    x = Fixed(Fixed.around(1.5).lower, Fixed.around(1.7).upper)  # pi/2 lies between
    assert x.sin_cos()[0].upper >= ONE - 1
    for value in (1.5, 1.6, 1.7):
        assert x.sin_cos()[1].lower <= round(np.cos(value) * 2**60) << (PLACES - 60) <= x.sin_cos()[1].upper
    assert (Fixed(-ONE, ONE).square().lower, Fixed(-ONE, ONE).absolute().lower) == (0, 0)


def test_what_cannot_be_decided_is_refused() -> None:
    around_zero, one = Fixed(-1, 1), Fixed(ONE, ONE)
    with pytest.raises(UndecidedError, match="a divisor may be zero"):
        one / around_zero
    with pytest.raises(UndecidedError, match="may be negative"):
        around_zero.sqrt()
    x = ca.SX.sym("x")
    for expression in (ca.if_else(x > 0, 1, 2), ca.sign(x), (x < 0) * x):
        with pytest.raises(UndecidedError, match="cannot be decided"):
            fixed_values(read(ca.Function("f", [x], [expression])), [[around_zero]])
    with pytest.raises(UndecidedError, match="no enclosure is known of acos"):
        fixed_values(read(ca.Function("f", [x], [ca.acos(x)])), [[around_zero]])
    both = read(ca.Function("f", [x], [ca.logic_and(x > 0, x > 1), ca.logic_or(x > 0, x < 1), x > 0]))
    found = [value for (value,) in both.stored(fixed_values(both, [[around_zero]]))]
    assert [value is MAYBE or value.lower // ONE for value in found] == [0, 1, True]


def number(value: float) -> Any:
    exact = literal(value)
    return mpmath.mpf(exact.numerator) / exact.denominator


def stiff(size: int) -> np.ndarray:
    random = np.random.default_rng(4)
    root = random.normal(size=(size, size))
    return np.asarray(np.round(random.normal(size=(size, size)) - 300 * root @ root.T, 3))


@pytest.mark.parametrize("time", [0.002, 0.5])
def test_the_transition_of_a_held_system_is_mpmaths_to_fifty_digits(time: float) -> None:
    A = stiff(5)
    transition, integral = held(Matrix.of([[Fixed.around(float(v)) for v in row] for row in A], 5), Fixed.around(time))
    with mpmath.workprec(3000):
        exact = mpmath.matrix([[number(float(value)) for value in row] for row in A])
        t = number(time)
        wanted = mpmath.expm(exact * t)
        summed = mpmath.inverse(exact) * (wanted - mpmath.eye(5))
        for found, mp in ((transition, wanted), (integral, summed)):
            for (i, j), middle in np.ndenumerate(found.middle):
                assert holds(Fixed(middle - found.radius[i, j], middle + found.radius[i, j]), mp[i, j])
            assert max(found.radius.ravel()) * 10**50 < ONE
    np.testing.assert_allclose(transition.floats(), scipy.linalg.expm(A * time), atol=1e-12)


def test_a_series_that_forgets_its_rest_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    A, time = Matrix.exactly([[-1.0]]), Fixed(ONE, ONE)
    monkeypatch.setattr("dmframe.exact.matrix._zeros", lambda rows, columns: np.array([[-(10**60)]], dtype=object))
    transition, _ = held(A, time)
    with mpmath.workprec(600):
        middle, radius = transition.middle[0, 0], transition.radius[0, 0]
        assert not holds(Fixed(middle - radius, middle + radius), mpmath.exp(-1))


def test_definiteness_is_that_of_the_worst_matrix_inside() -> None:
    wide = Matrix.exactly([[2.0, 1.0], [1.0, 1.0]])
    assert wide.positive_definite()
    wide.radius[1, 1] = ONE // 2 + 1  # 2 * 1/2 = 1 * 1: singular at the lower end
    assert not wide.positive_definite()
    assert not Matrix.exactly([[1.0, 1.0], [1.0, 1.0]]).positive_definite()
    random = np.random.default_rng(1)
    for _ in range(20):
        S = random.normal(size=(6, 6))
        S = S + S.T + random.uniform(0, 6) * np.eye(6)
        assert Matrix.exactly(S).positive_definite() == bool(np.all(np.linalg.eigvalsh(S) > 0))


def test_matrices_are_scaled_and_multiplied_within_their_radii() -> None:
    random = np.random.default_rng(2)
    a, b = random.normal(size=(3, 4)), random.normal(size=(4, 2))
    product = (Matrix.exactly(a) @ Matrix.exactly(b)).scaled([3, -2, 0], [1, -300])
    np.testing.assert_allclose(product.floats(), np.diag([8, 0.25, 1]) @ a @ b @ np.diag([2, 2.0**-300]), atol=1e-14)
    exact = sum(Fraction(float(x)) * Fraction(float(y)) for x, y in zip(a[1], b[:, 0], strict=True)) / 2
    assert abs(Fraction(int(product.middle[1, 0]), ONE) - exact) <= Fraction(int(product.radius[1, 0]), ONE)
