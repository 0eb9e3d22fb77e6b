"""Boxes and balls: nearest points, tangent cones and the projection lemma, at random points and by hand."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy

from dmframe.diagram.projection import Ball, Box


def column(values: Any) -> Any:
    return ca.SX(ca.DM(np.asarray(values, dtype=float)))


def numbers(expression: Any) -> np.ndarray:
    return np.array(ca.DM(ca.evalf(ca.densify(expression)))).ravel()


def test_a_ball_of_one_radius_holds_the_nearest_point() -> None:
    ball = Ball(column([1, 0, 0]), column([2, 2, 2]), column([1, 1, 1]))
    rng = np.random.default_rng(0)
    for _ in range(5):
        point = rng.normal(size=3) * 4
        near = scipy.optimize.minimize(
            lambda x, point=point: float(np.sum((x - point) ** 2)),
            [1.0, 0.0, 0.0],
            constraints={"type": "ineq", "fun": lambda x: 4 - np.sum((x - [1, 0, 0]) ** 2)},
        )
        np.testing.assert_allclose(numbers(ball.held(column(point))), near.x, atol=1e-3)


def test_a_point_inside_a_ball_stays_and_one_outside_an_ellipsoid_comes_to_its_surface() -> None:
    ellipsoid = Ball(column([0, 1]), column([1, 3]), column([1, 1]))
    np.testing.assert_array_equal(numbers(ellipsoid.held(column([0.5, 2]))), [0.5, 2])
    np.testing.assert_allclose(numbers(ellipsoid.held(column([0, 10]))), [0, 4])
    np.testing.assert_allclose(numbers(ellipsoid.held(column([-5, 1]))), [-1, 1])


def test_a_rate_that_leads_out_of_a_ball_slides_along_its_surface() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        center, radius, gain = rng.normal(size=3), rng.uniform(0.5, 2, 3), rng.uniform(0.1, 10, 3)
        direction = rng.normal(size=3)
        rim = center + radius * direction / np.linalg.norm(direction) * (1 + 1e-12)
        nominal, normal = rng.normal(size=3), (rim - center) / radius**2
        correction = numbers(Ball(column(center), column(radius), column(gain)).law(column(rim), column(nominal)))
        if normal @ nominal <= 0:
            np.testing.assert_array_equal(correction, 0)
            continue
        assert normal @ (nominal + correction) == pytest.approx(0, abs=1e-10)
        expected = nominal - gain * normal * (normal @ nominal) / (normal @ (gain * normal))
        np.testing.assert_allclose(nominal + correction, expected, atol=1e-12)


def test_no_correction_raises_the_storage_whatever_the_gain_and_the_true_value_in_the_set() -> None:
    rng = np.random.default_rng(2)
    seen = {"ball": 0, "box": 0}
    for _ in range(200):
        center, radius, gain = rng.normal(size=3), rng.uniform(0.5, 2, 3), rng.uniform(0.1, 10, 3)
        away, inward = rng.normal(size=3), rng.normal(size=3)
        rim = center + radius * away / np.linalg.norm(away) * (1 + 1e-12)
        truth = center + radius * inward / np.linalg.norm(inward) * rng.uniform(0, 1)
        nominal = rng.normal(size=3)
        correction = numbers(Ball(column(center), column(radius), column(gain)).law(column(rim), column(nominal)))
        assert (rim - truth) @ (correction / gain) <= 1e-12
        seen["ball"] += bool(correction.any())

        lower, upper = center - radius, center + radius
        held = np.where(rng.uniform(size=3) < 0.5, upper, rng.uniform(lower, upper))
        truth = rng.uniform(lower, upper)
        correction = numbers(Box(column(lower), column(upper)).law(column(held), column(nominal)))
        assert (held - truth) @ (correction / gain) <= 1e-12
        seen["box"] += bool(correction.any())
    assert min(seen.values()) > 50


def test_the_room_is_negative_outside_and_the_metric_detects_a_skew_gain() -> None:
    ball = Ball(column([0, 0]), column([2, 2]), column([1, 5]))
    assert numbers(ball.room(column([0, 1])))[0] == pytest.approx(0.75)
    assert numbers(ball.room(column([0, 3])))[0] < 0
    np.testing.assert_allclose(numbers(ball.askew(column([7, 7 / 5]))), 0)
    assert np.any(numbers(ball.askew(column([7, 7]))))
    box = Box(column([0, 0]), column([1, 2]))
    np.testing.assert_allclose(numbers(box.room(column([0.25, 3]))), [0.25, 3, 0.75, -1])
    assert box.askew(column([1, 2])).is_zero()
