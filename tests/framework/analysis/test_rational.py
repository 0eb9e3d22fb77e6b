from __future__ import annotations

import numpy as np
import pytest
import scipy

from dmframe.analysis import Rational, passivity, transfer


def rational(num: list[float], den: list[float]) -> Rational:
    return Rational(np.array(num, dtype=float), np.array(den, dtype=float))


def test_a_transfer_function_is_scipys() -> None:
    rng = np.random.default_rng(0)
    A, b, c = rng.normal(size=(4, 4)), rng.normal(size=4), rng.normal(size=4)
    num, den = scipy.signal.ss2tf(A, b[:, None], c[None, :], np.array([[0.7]]))
    found = transfer(A, b, c, 0.7)
    assert np.allclose(found.num, num[0], atol=1e-12)
    assert np.allclose(found.den, den, atol=1e-12)


def test_states_that_no_input_reaches_or_no_output_shows_leave_no_pole() -> None:
    A = np.diag([-1.0, -2.0, -3.0])
    found = transfer(A, np.array([1.0, 0.0, 1.0]), np.array([2.0, 1.0, 0.0]), 0.0)
    assert np.allclose(found.num, [2])
    assert np.allclose(found.den, [1, 1])


def test_a_pole_that_a_zero_cancels_is_left_out() -> None:
    # (s + 2) / ((s + 2)(s + 5)) in a form with a different sparsity pattern
    T = np.array([[1.0, 0.3], [0.2, 1.0]])
    A, b, c = T @ np.diag([-2.0, -5.0]) @ np.linalg.inv(T), T @ [0.0, 1.0], np.array([1.0, 1.0]) @ np.linalg.inv(T)
    found = transfer(A, b, c, 0.0)
    assert np.allclose(found.poles, [-5], atol=1e-6)
    assert np.isclose(found.at(1.0), 1 / 6)


@pytest.mark.parametrize(
    ("num", "den", "holds", "least"),
    [
        ([3, 5], [1, 0], True, 3.0),  # PI
        ([3, 5, 2], [1, 0, 0], False, -np.inf),  # PID from velocity: Re = 3 - 2/w^2
        ([1], [1, 1], True, 0.0),
        ([1], [1, 2, 1], False, -0.125),  # Re = (1 - w^2)/(1 + w^2)^2, least at w^2 = 3
        ([1, 0], [1, 0, 4], True, 0.0),  # a lossless oscillator
        ([-1, 0], [1, 0, 4], False, 0.0),
        ([1, 1], [1, -1], False, -1.0),  # a pole in the right half-plane
        ([1, 0, 0], [1, 1], False, 0.0),  # grows faster than a passive transfer function can
    ],
)
def test_positive_realness_by_hand(num: list[float], den: list[float], holds: bool, least: float) -> None:
    found = passivity(rational(num, den))
    assert found.holds is holds
    if holds or np.isinf(least) or least < 0:
        assert found.least == pytest.approx(least, abs=1e-9)


def test_the_least_real_part_is_that_of_a_dense_sweep() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        system = Rational(rng.uniform(0.1, 2, 3), np.poly(-rng.uniform(0.2, 3, 2)))
        values = system.at(1j * np.logspace(-4, 4, 20001)).real
        assert passivity(system).least == pytest.approx(float(values.min()), abs=1e-5)
