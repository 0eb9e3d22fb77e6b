"""Each law of adaptation compared with NumPy, and its terms in the derivative of its storage, by hand."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from dmframe.block.adaptation import Adaptation, Estimate
from dmframe.block.certificate import Clipped, NormSquare, Square, beyond, clip, norm

GAIN, WEIGHT = np.array([2.0, 3.0]), 1 / np.array([2.0, 3.0])
TRUTH, NOMINAL = np.array([1.0, -0.5]), np.array([0.2, 0.1])
LEAK, ERROR_LEAK, WIDTH = 0.3, 0.7, 0.4
CHOICES = [
    {},
    {"leak": LEAK},
    {"error_leak": ERROR_LEAK},
    {"width": WIDTH},
    {"leak": LEAK, "error_leak": ERROR_LEAK, "width": WIDTH},
]


def law(**chosen: float) -> Adaptation:
    numbers: dict[str, Any] = {"leak": None, "error_leak": None, "width": None} | chosen
    return Adaptation(**{name: None if value is None else ca.SX(value) for name, value in numbers.items()})


def by_hand(phi: np.ndarray, s: np.ndarray, theta: np.ndarray, chosen: dict[str, float]) -> np.ndarray:
    """The rate of theta for the gradient Gamma phi s, from the formulas of a textbook."""
    width = chosen.get("width", 0.0)
    outside = np.sign(s) * np.maximum(np.abs(s) - width, 0)
    rate = -GAIN * (phi.T @ outside)
    rate -= chosen.get("leak", 0.0) * (theta - NOMINAL)
    rate -= chosen.get("error_leak", 0.0) * np.sqrt(s @ s) * (theta - NOMINAL)
    return rate


def number(expression: Any) -> float:
    return float(ca.DM(ca.evalf(expression)))


@pytest.mark.parametrize("chosen", CHOICES, ids=lambda chosen: " and ".join(chosen) or "gradient")
def test_a_law_is_the_textbooks_and_its_storage_changes_by_what_it_states(chosen: dict[str, float]) -> None:
    rng, made = np.random.default_rng(1), law(**chosen)
    for _ in range(20):
        phi, s, theta = rng.normal(size=(3, 2)), rng.normal(size=3) * rng.choice([0.2, 2.0]), rng.normal(size=2)
        error = ca.SX(ca.DM(s))
        gradient = -ca.DM(GAIN) * (ca.DM(phi).T @ made.drive(error))
        rate = np.array(ca.DM(ca.evalf(made.rate(gradient, ca.SX(ca.DM(theta)), ca.SX(ca.DM(NOMINAL)), error)))).ravel()
        np.testing.assert_allclose(rate, by_hand(phi, s, theta, chosen), atol=1e-12)

        columns = [ca.SX(ca.DM(x)) for x in (theta, TRUTH, NOMINAL, WEIGHT)]
        estimate = Estimate(*columns)
        effect = phi @ (theta - TRUTH)
        robust = made.terms([estimate], error) + made.idle(error, ca.SX(ca.DM(effect)))
        reported = sum((number(term.value) for term in robust.residual), 0.0)
        reported -= sum((number(term.value) for term in robust.dissipation), 0.0)
        assert (theta - TRUTH) * WEIGHT @ rate == pytest.approx(-s @ effect + reported, abs=1e-12)


def test_a_leak_leaves_half_its_rate_times_the_squared_error_of_the_start() -> None:
    columns = [ca.SX(ca.DM(x)) for x in ([5.0, 5.0], TRUTH, NOMINAL, WEIGHT)]
    robust = law(leak=LEAK).terms([Estimate(*columns)], ca.SX(3, 1))
    (left,) = robust.residual
    assert isinstance(left, Square)
    assert number(left.value) == pytest.approx(0.3 / 2 * (0.8**2 / 2 + 0.6**2 / 3))
    assert all(isinstance(term, Square) for term in robust.dissipation)


def test_an_error_leak_weighs_the_same_squares_with_the_norm_of_the_error() -> None:
    columns = [ca.SX(ca.DM(x)) for x in ([5.0, 5.0], TRUTH, NOMINAL, WEIGHT)]
    robust = law(error_leak=0.3).terms([Estimate(*columns)], ca.SX(ca.DM([3.0, 0.0, -4.0])))
    (left,) = robust.residual
    assert isinstance(left, NormSquare)
    assert number(left.value) == pytest.approx(5 * 0.3 / 2 * (0.8**2 / 2 + 0.6**2 / 3))


def test_a_dead_zone_leaves_at_most_its_width_times_what_it_ignores() -> None:
    effect = np.array([2.0, -1.0, 4.0])
    robust = law(width=0.4).idle(ca.SX(ca.DM([9.0, -9.0, 0.1])), ca.SX(ca.DM(effect)))
    (left,) = robust.residual
    assert isinstance(left, Clipped)
    assert number(left.value) == pytest.approx(0.4 * 2 + 0.4 * 1 + 0.1 * 4)
    assert number(left.value) <= 0.4 * np.abs(effect).sum()


def test_the_dead_zone_and_the_clip_add_up_to_their_argument() -> None:
    x, width = ca.SX.sym("x", 3), ca.SX.sym("width", 3)
    function = ca.Function("f", [x, width], [beyond(x, width), clip(x, width)])
    rng = np.random.default_rng(2)
    for _ in range(10):
        point, v = rng.normal(size=3), rng.uniform(0.1, 1, 3)
        outside, within = (value.full().ravel() for value in function(point, v))
        np.testing.assert_allclose(within, np.clip(point, -v, v), atol=1e-15)
        np.testing.assert_allclose(outside + within, point, atol=1e-15)


def test_a_norm_has_a_derivative_at_zero() -> None:
    x = ca.SX.sym("x", 2)
    function = ca.Function("f", [x], [norm(x), ca.gradient(norm(x), x)])
    value, slope = function([0, 0])
    assert float(value) < 1e-14
    np.testing.assert_array_equal(slope.full().ravel(), [0, 0])
    assert float(function([3, -4])[0]) == pytest.approx(5)
