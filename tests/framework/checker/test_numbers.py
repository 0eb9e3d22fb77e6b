"""Degree bound, intervals and pivots of `check.py`, with known values."""

from __future__ import annotations

import numpy as np
import pytest

from tests.framework.checker.certificates import checker


def test_the_degree_bound_of_a_known_polynomial() -> None:
    check = checker()
    x = check.Node("symbol", value=("x", 0))
    product = (x + check.number(3)) * (x * x)  # (x + 3) x^2: degree 3, coefficients 1 and 3
    assert check.complexity([product], {}) >= 3 + np.log2(4)
    assert check.complexity([check.ONE / product], {}) >= 2 * check.complexity([product], {})
    assert check.complexity([check.Node("tanh", product), check.Node("tanh", x)], {}) >= 3 + 1
    assert check.complexity([product], {x: check.Fraction(2**1000 - 1)}) >= 3 * 1000


def test_intervals_and_pivots_decide_signs() -> None:
    check = checker()
    F, interval = check.Fraction, check.interval
    x, y = (check.Node("symbol", value=(label, 0)) for label in "xy")
    known = {x: (F(-1), F(2)), y: (F(3), F(4))}
    for node, ends in (
        (x * x, (0, 4)),
        (y * y, (9, 16)),
        (x * y, (-4, 8)),
        (x + y, (2, 6)),
        (x - y, (-5, -1)),
        (check.ONE / y, (F(1, 4), F(1, 3))),
        (check.Node("fabs", x), (0, 2)),
        (check.Node("fabs", x - y), (1, 5)),
    ):
        assert check.evaluate([node], interval, dict(known)) == [ends]
    for node in (check.ONE / x, check.Node("sin", x), check.Node("symbol", value=("z", 0))):
        with pytest.raises(ArithmeticError):
            check.evaluate([node], interval, dict(known))
    for elements, positive in (
        ((2, 1, 1, 1), True),
        ((1, 2, 2, 1), False),
        ((1, 4, 0, 1), False),
        ((2, 2, 0, 1), True),
    ):
        rows = check.matrix(check.symmetric([check.number(x) for x in elements], 2), 2)
        values = check.evaluate(check.pivots(rows), interval, {})
        assert (min(lower for lower, _ in values) > 0) == positive
    one, between = check.Node("symbol", value=("one", 0)), check.Node("symbol", value=("between", 0))
    rows = [[between, one], [one, check.ONE]]
    known = {one: (F(1), F(1)), between: (F(1), F(2))}
    assert min(lower for lower, _ in check.evaluate(check.pivots(rows), interval, known)) == 0
