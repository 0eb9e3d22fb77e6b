"""The natural gain of a body compared with its definition and closed form, and its invariance to frames."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pinocchio as pin
import pytest

from dmframe.block.gain import check_definite
from dmframe.robot.pseudo_inertia import natural_gain, pseudo_inertia


def body(seed: int) -> pin.Inertia:
    rng = np.random.default_rng(seed)
    inertia = pin.Inertia.FromEllipsoid(rng.uniform(0.5, 5), *rng.uniform(0.05, 0.5, size=3))
    return pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3)).act(inertia)


def exact(parameters: np.ndarray) -> list[Fraction]:
    return [Fraction(float(value)) for value in parameters]


def gain(parameters: np.ndarray) -> np.ndarray:
    return np.array(natural_gain(exact(parameters)), dtype=float)


def pseudo(parameters: np.ndarray) -> np.ndarray:
    return np.array(pseudo_inertia(exact(parameters)), dtype=float)


@pytest.mark.parametrize("seed", range(4))
def test_it_is_the_inverse_of_the_metric_at_the_bodys_pseudo_inertia(seed: int) -> None:
    phi = body(seed).toDynamicParameters()
    inverse, directions = np.linalg.inv(pseudo(phi)), [pseudo(row) for row in np.eye(10)]
    metric = [[np.trace(inverse @ a @ inverse @ b) for b in directions] for a in directions]
    np.testing.assert_allclose(gain(phi) @ metric, np.eye(10), atol=1e-6)


def test_the_closed_form_of_one_link() -> None:
    """A rod of mass m along x with finite thickness: by hand, with Sigma its second moments about the joint."""
    m, h, S_x, S_y = 2.0, 0.6, 0.3, 0.01
    phi = np.array([m, h, 0, 0, 2 * S_y, 0, S_x + S_y, 0, 0, S_x + S_y])
    found = gain(phi)
    assert found[0, 0] == pytest.approx(m * m)
    assert found[0, 1] == pytest.approx(m * h)
    assert found[1, 1] == pytest.approx((m * S_x + h * h) / 2)
    assert found[0, 9] == pytest.approx(h * h)
    assert found[9, 9] == pytest.approx(S_x**2 + S_y**2)
    assert found[5, 5] == pytest.approx(S_x * S_y / 2)


@pytest.mark.parametrize("seed", range(4))
def test_the_whole_of_a_body_as_its_own_error_costs_the_same_for_every_body(seed: int) -> None:
    phi = body(seed).toDynamicParameters()
    assert phi @ np.linalg.solve(gain(phi), phi) == pytest.approx(4)  # tr(1) of 4 x 4


def test_no_change_of_frame_or_of_units_changes_what_an_error_costs() -> None:
    first, error = body(1), body(2).toDynamicParameters() - body(3).toDynamicParameters()
    placement = pin.SE3(pin.exp3(np.array([0.3, -1, 0.5])), np.array([0.2, 0.4, -0.7]))
    turned = np.array([placement.act(pin.Inertia.FromDynamicParameters(row)).toDynamicParameters() for row in BASIS]).T
    change = turned @ np.linalg.inv(np.array(BASIS).T)
    cost = error @ np.linalg.solve(gain(first.toDynamicParameters()), error)
    moved = change @ error
    assert moved @ np.linalg.solve(gain(placement.act(first).toDynamicParameters()), moved) == pytest.approx(cost)
    units = np.array([1e3, 1e6, 1e6, 1e6, *[1e9] * 6])  # g and mm
    scaled = gain(units * first.toDynamicParameters())
    assert (units * error) @ np.linalg.solve(scaled, units * error) == pytest.approx(cost)


BASIS = [body(seed).toDynamicParameters() for seed in range(10, 20)]


def test_it_is_positive_definite_for_a_body_and_for_nothing_else() -> None:
    phi = body(0).toDynamicParameters()
    check_definite(tuple(map(tuple, gain(phi).tolist())))
    point = pin.Inertia(1.0, np.array([0.3, 0, 0]), np.zeros((3, 3))).toDynamicParameters()
    with pytest.raises(ValueError, match="expected a positive definite matrix"):
        check_definite(tuple(map(tuple, gain(point).tolist())))
