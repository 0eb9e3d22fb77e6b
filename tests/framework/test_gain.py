"""Gains that are matrices: which are accepted as positive definite, and their symbols in a diagram."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dmframe.block.gain import Prior, check_definite
from dmframe.block.parameter import Spec, array, read
from dmframe.block.symmetric import symmetric_symbol, unique
from dmframe.common.errors import DmframeError

GAIN = Spec("p", "", "> 0", "gain")


def rows(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(map(tuple, matrix.tolist()))


def positive(n: int, seed: int) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(n, n))
    matrix: np.ndarray = root @ root.T + np.eye(n)
    return (matrix + matrix.T) / 2


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(1, 6), st.integers(0, 10**6), st.booleans())
def test_it_is_positive_definite_where_its_eigenvalues_are_positive(n: int, seed: int, spoil: bool) -> None:
    matrix = positive(n, seed)
    if spoil:
        matrix -= np.eye(n) * np.linalg.eigvalsh(matrix)[0] * 1.01
    least = np.linalg.eigvalsh(matrix)[0]
    try:
        check_definite(rows(matrix))
    except ValueError:
        assert least < 0
    else:
        assert least > 0


@pytest.mark.parametrize(
    ("matrix", "text"),
    [
        ([[1, 2, 0], [2, 1, 0], [0, 0, 1]], "expected a positive definite matrix, found the pivot -3 at [1, 1]"),
        ([[0.1, 0.3], [0.3, 0.9]], "expected a positive definite matrix, found the pivot 0 at [1, 1]"),
        ([[0]], "expected a positive definite matrix, found the pivot 0 at [0, 0]"),
        ([[1, 2], [3, 10]], "expected a symmetric matrix, found 3 at [1, 0] and 2 at [0, 1]"),
        ([[1, 2], [2 + 1e-15, 10]], "expected a symmetric matrix, found 2.0000000000000009 at [1, 0] and 2 at [0, 1]"),
        ([[1, 2]], "expected a square matrix, found 1 x 2"),
        ([[2, 3, 0], [1, 2]], "expected rows of one length, found rows of 3 and 2 numbers in [[2, 3, 0], [1, 2]]"),
        (
            [[2, 0], 1],
            "expected a number, a list of numbers, or the rows of a symmetric positive definite matrix, "
            "found [[2, 0], 1]",
        ),
    ],
)
def test_the_first_element_that_is_wrong_is_named(matrix: Any, text: str) -> None:
    with pytest.raises(ValueError, match="^" + re.escape(text) + "$"):
        read(matrix, GAIN)


def test_a_matrix_is_judged_by_its_decimals_and_not_by_rounded_sums() -> None:
    """In doubles the second pivot, 0.9 + 1e-16 - 0.3^2 / 0.1, is positive by rounding only."""
    assert 0.9 - 0.3 * 0.3 / 0.1 > 0
    with pytest.raises(ValueError, match="the pivot 0"):
        check_definite(((0.1, 0.3), (0.3, 0.9)))
    check_definite(((0.1, 0.3), (0.3, 0.9000000000000001)))


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (2, 2.0),
        ([1, 2], (1.0, 2.0)),
        ([[2, -1], [-1, 2]], ((2.0, -1.0), (-1.0, 2.0))),
        ({"inverse_of": "model"}, Prior("model")),
        ({"inverse_of": "model", "others": 3, "scale": 0.1}, Prior("model", 0.1, 3.0)),
        (Prior("model", 2.0), Prior("model", 2.0)),
    ],
)
def test_a_gain_is_a_number_a_list_rows_or_a_models_prior(value: Any, expected: Any) -> None:
    assert read(value, GAIN) == expected


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0, "expected a number > 0, found 0"),
        ([1, -2], "expected a number > 0, found -2"),
        ([[1], 2], "a list of numbers, or the rows of a symmetric positive definite matrix, found [[1], 2]"),
        ({"scale": 2}, "a list of numbers, or the rows of a symmetric positive definite matrix, found {'scale': 2}"),
        ({"inverse_of": "model", "scal": 2}, "expected the keys inverse_of, scale, others; did you mean scale?"),
        ({"inverse_of": "model", "scale": 0}, "expected a number > 0, found 0"),
        ({"inverse_of": 3}, "expected inverse_of to name a block, found 3"),
    ],
)
def test_anything_else_is_reported_what_was_expected(value: Any, text: str) -> None:
    with pytest.raises((ValueError, DmframeError)) as caught:
        read(value, GAIN)
    assert text in str(caught.value)


def test_a_matrix_must_have_the_size_of_what_it_adapts() -> None:
    assert array(((2.0, 1.0), (1.0, 2.0)), GAIN, (2,)).shape == (2, 2)
    with pytest.raises(ValueError, match=r"expected \[3, 3\] numbers, found \[2, 2\]"):
        array(((2.0, 1.0), (1.0, 2.0)), GAIN, (3,))


def test_its_symbols_are_symmetric_and_zero_where_its_value_is() -> None:
    value = np.array([[4.0, 1, 0], [1, 5, 0], [0, 0, 6]])
    symbol = symmetric_symbol("Gamma", value)
    assert symbol.shape == (3, 3)
    assert all(symbol[i, j].is_zero() == (value[i, j] == 0) for i in range(3) for j in range(3))
    assert symbol[0, 1].element_hash() == symbol[1, 0].element_hash()
    symbols, values = unique(GAIN, symbol, value)
    assert symbols.shape == (4, 1)
    assert values.tolist() == [4, 1, 5, 6]


def test_a_value_that_has_no_symbol_takes_another_diagram() -> None:
    value = np.array([[4.0, 1, 0], [1, 5, 0], [0, 0, 6]])
    symbol = symmetric_symbol("Gamma", value)
    assert unique(GAIN, symbol, np.array([1.0, 2, 3]))[1].tolist() == [1, 0, 2, 3]
    with pytest.raises(ValueError, match="expected the zeros of the diagram's matrix"):
        unique(GAIN, symbol, positive(3, 0))
    with pytest.raises(ValueError, match="expected a diagonal, as in the diagram"):
        unique(GAIN, symbol[:, 0], value)
