"""Parameters: the allowed forms of a number in a graph or a call, and the error for all others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dmframe.block.parameter import Spec, array, read
from dmframe.common.errors import DmframeError

GAIN = Spec("n", "rad/s", "> 0")


@pytest.mark.parametrize(
    ("value", "spec", "expected"),
    [
        (2, GAIN, 2.0),
        ("180 deg/s", GAIN, np.pi),
        ([1, "60 rpm"], GAIN, (1.0, 2 * np.pi)),
        (np.array([1, 2]), GAIN, (1.0, 2.0)),
        (np.float64(3), GAIN, 3.0),
        ([1], Spec("m", "m", "", "vector"), (1.0,)),
        ([[1, 2], [3, "4 mm"]], Spec("* m", "m", "", "table"), ((1.0, 2.0), (3.0, 0.004))),
        (None, Spec("n", "", "", "box"), None),
        ([0, [1, 2]], Spec("n", "", "", "box"), (0.0, (1.0, 2.0))),
        ([1, 1], Spec("n", "", "", "box"), (1.0, 1.0)),
        (0, Spec("", "", ">= 0"), 0.0),
    ],
)
def test_numbers_texts_and_lists_are_read_in_the_parameters_unit(value: Any, spec: Spec, expected: Any) -> None:
    assert np.array_equal(np.asarray(read(value, spec), dtype=object), np.asarray(expected, dtype=object))


@pytest.mark.parametrize(
    ("value", "spec", "text"),
    [
        (None, GAIN, "expected a number in rad/s or a list of numbers, found nothing"),
        (True, GAIN, "expected a number in rad/s or a list of numbers, found true"),
        ([], GAIN, "expected a number in rad/s or a list of numbers, found an empty list"),
        ({"a": 1}, GAIN, "expected a number in rad/s or a list of numbers, found {'a': 1}"),
        ([[1]], GAIN, "expected a number in rad/s or a list of numbers, found [[1]]"),
        ([1, [2]], GAIN, "expected a number in rad/s or a list of numbers, found [1, [2]]"),
        ([1, 2], Spec("", "m"), "expected a number in m, found [1, 2]"),
        (1, Spec("m", "m", "", "vector"), "expected a list of numbers in m, found 1"),
        (0, GAIN, "expected a number > 0, found 0"),
        (-1, Spec("", "", ">= 0"), "expected a number >= 0, found -1"),
        (10**400, GAIN, "expected a finite number, found 1000000000000000000000000000000000000..."),
        (float("nan"), GAIN, None),
        ([1], Spec("n", "", "", "box"), "expected an interval [lower, upper], found [1]"),
        (1, Spec("n", "", "", "box"), "expected an interval [lower, upper], found 1"),
        ([2, 1], Spec("n", "", "", "box"), "expected lower <= upper, found [2, 1]"),
        ([[1, 2], [1, 2, 3]], Spec("n", "", "", "box"), "expected as many lower bounds as upper bounds, found 2 and 3"),
        ([[[1]], 2], Spec("n", "", "", "box"), "expected an interval [lower, upper], found [[[1]], 2]"),
        (
            [[1, 2], [1]],
            Spec("* m", "m", "", "table"),
            "expected a list of rows of equal length in m, found [[1, 2], [1]]",
        ),
    ],
)
def test_any_other_value_is_refused_with_what_was_expected(value: Any, spec: Spec, text: str | None) -> None:
    with pytest.raises((ValueError, DmframeError)) as caught:
        read(value, spec)
    assert text is None or str(caught.value) == text


def test_one_number_fills_the_size_and_a_list_must_fit_it() -> None:
    assert array(2.0, GAIN, (3,)).tolist() == [2, 2, 2]
    assert array((1.0, 2.0), GAIN, (2,)).tolist() == [1, 2]
    with pytest.raises(ValueError, match=r"expected \[3\] numbers, found \[2\]"):
        array((1.0, 2.0), GAIN, (3,))


def test_a_box_has_a_row_an_element_and_two_columns() -> None:
    box = Spec("n", "", "", "box")
    assert array((0.0, (1.0, 2.0)), box, (2,)).tolist() == [[0, 1], [0, 2]]
    assert array((0.0, 1.0), Spec("", "", "", "box"), ()).tolist() == [[0, 1]]


NESTED = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text("a1.-e[ ]\n\0µ²…", max_size=4),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=2), inner, max_size=2),
    max_leaves=6,
)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(NESTED, st.sampled_from(["diagonal", "vector", "table", "box"]), st.sampled_from(["", "n"]))
def test_whatever_a_file_holds_is_read_or_refused_in_words(value: Any, form: str, shape: str) -> None:
    reported, found = "", None
    try:
        found = read(value, Spec(shape, "m", "", form))
    except (ValueError, DmframeError) as error:
        reported = str(error)
    assert not reported or ("expected" in reported and "\n" not in reported)
    assert all(np.isfinite(number) for number in numbers_in(found))


def numbers_in(found: Any) -> list[float]:
    if isinstance(found, tuple):
        return [number for item in found for number in numbers_in(item)]
    return [] if found is None else [found]
