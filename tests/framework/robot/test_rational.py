from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

from dmframe.robot.rational import decimal, rational_axis, rational_rotation, simplest_between, simplest_near

IDENTITY = [[int(i == j) for j in range(3)] for i in range(3)]
angle = st.floats(-4, 4)


def gram(R):
    return [[sum(R[k][i] * R[k][j] for k in range(3)) for j in range(3)] for i in range(3)]


def determinant(R):
    (a, b, c), (d, e, f), (g, h, i) = R
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def change(R, exact):
    return np.max(np.abs(np.array(exact, dtype=float) - R))


@settings(max_examples=100, derandomize=True)
@given(st.tuples(angle, angle, angle))
def test_a_rational_rotation_is_exactly_orthogonal_and_next_to_the_rounded_one(rpy):
    R = scipy.spatial.transform.Rotation.from_euler("xyz", rpy).as_matrix()
    exact = rational_rotation(R)
    assert gram(exact) == IDENTITY
    assert determinant(exact) == 1
    assert change(R, exact) < 2e-10 if change(R, np.rint(R)) < 1e-10 else change(R, exact) < 3e-15


@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("turn", [np.pi, np.pi / 2, -np.pi / 2, np.pi - 1e-6, 3.0, 1e-7])
def test_a_rotation_near_a_half_turn_or_none_loses_no_accuracy(axis, turn):
    R = scipy.spatial.transform.Rotation.from_euler(axis, turn).as_matrix()
    exact = rational_rotation(R)
    assert gram(exact) == IDENTITY
    assert change(R, exact) < 2e-15


def test_a_quarter_turn_of_ten_digits_is_a_quarter_turn():
    R = scipy.spatial.transform.Rotation.from_euler("y", 1.57079632679).as_matrix()
    assert rational_rotation(R) == ((0, 0, 1), (0, 1, 0), (-1, 0, 0))


def test_a_quarter_turn_of_five_digits_stays_what_it_is():
    R = scipy.spatial.transform.Rotation.from_euler("y", 1.5708).as_matrix()
    exact = rational_rotation(R)
    assert exact[0][0] != 0
    assert float(exact[0][0]) == pytest.approx(np.cos(1.5708), rel=1e-9)


def test_a_rotation_of_pythagorean_sides_keeps_its_simple_fractions():
    R = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    assert rational_rotation(R)[0] == (Fraction(3, 5), Fraction(-4, 5), 0)


@settings(max_examples=100, derandomize=True)
@given(st.tuples(angle, angle, angle).filter(lambda a: np.linalg.norm(a) > 1e-3))
def test_a_rational_axis_has_exactly_unit_length_and_the_direction_of_the_rounded_one(a):
    unit = np.array(a) / np.linalg.norm(a)
    exact = rational_axis(unit)
    assert sum(x * x for x in exact) == 1
    assert np.max(np.abs(np.array(exact, dtype=float) - unit)) < 2e-10


def test_an_axis_within_rounding_of_a_coordinate_axis_becomes_it():
    assert rational_axis(np.array([3e-11, -1.0, 4.9e-12])) == (0, -1, 0)
    assert rational_axis(np.array([3e-6, -1.0, 0.0])) != (0, -1, 0)
    assert rational_axis(np.array([0.0, 0.6, -0.8])) == (0, Fraction(3, 5), Fraction(-4, 5))


@settings(max_examples=100, derandomize=True)
@given(st.fractions(max_denominator=500), st.fractions(min_value=0, max_value=1, max_denominator=500))
def test_the_simplest_fraction_has_the_least_denominator_of_its_interval(low, width):
    high = low + width
    found = simplest_between(low, high)
    assert low <= found <= high
    smaller = range(1, found.denominator)
    assert not any(
        -(-low.numerator * d // low.denominator) * low.denominator <= high * d * low.denominator for d in smaller
    )


def test_the_simplest_fraction_near_a_float_is_the_one_it_was_rounded_from():
    assert simplest_near(1 / 3) == Fraction(1, 3)
    assert simplest_near(-22 / 7) == Fraction(-22, 7)
    assert simplest_near(1e-17) == 0


@settings(max_examples=100, derandomize=True)
@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_float_becomes_its_shortest_decimal_and_back(x):
    assert float(decimal(x)) == x
    assert decimal(0.612) == Fraction(153, 250)
