from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dmframe.common.errors import ValueFault
from dmframe.exact.literal import computed, literal

READ = {
    0.0: Fraction(0),
    0.75: Fraction(3, 4),
    -0.1: Fraction(-1, 10),
    0.3: Fraction(3, 10),
    1e23: Fraction(10**23),
    1e308: Fraction(10**308),
    5e-324: Fraction(1, 2**1074),
    2.0**-100: Fraction(1, 2**100),
    1 / 3: Fraction(1, 3),
    -22 / 7: Fraction(-22, 7),
    0.1 + 0.2: Fraction(0.1 + 0.2),
    math.pi: Fraction(math.pi),
    2 + 1e-15: Fraction(2 + 1e-15),
}


@pytest.mark.parametrize("value", READ)
def test_a_float_is_read_as_what_was_written(value: float) -> None:
    assert literal(value) == READ[value]


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_reading_rounds_to_its_float_so_that_no_two_floats_read_alike(value: float) -> None:
    assert float(literal(value)) == value


def test_what_a_program_computed_is_known_from_what_was_written() -> None:
    assert [computed(literal(x)) for x in (0.1 + 0.2, math.pi, 0.1, 1 / 3, 0.75, 0.0)] == [True, True] + [False] * 4


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_refused(value: float) -> None:
    with pytest.raises(ValueFault, match="expected finite constants, found"):
        literal(value)
