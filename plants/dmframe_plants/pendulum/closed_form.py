r"""The pendulum in closed form: :math:`(I + m l^2) \ddot q + m g_0 l \sin q = \tau`, [Spong2006]_ chapter 7.

It hangs at q = 0. Mass m with its centre at l from the pivot, inertia I about that centre, tip at a.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


@final
@dataclass(frozen=True)
class Parameters:
    """Parameters of the pendulum; the defaults are those of `pendulum.urdf`."""

    a: Any = 0.6  # [m]
    l: Any = 0.3  # noqa: E741 - the textbook's letter [m]
    m: Any = 2.0  # [kg]
    I: Any = 0.06  # noqa: E741 - the textbook's letter [kg m^2]
    g_0: Any = 9.81  # [m/s^2]


PENDULUM = Parameters()


def position(q: Array, p: Parameters = PENDULUM) -> Array:
    """The tip's x, shape (1,), m."""
    return np.array([p.a * np.sin(q[0])])


def jacobian(q: Array, p: Parameters = PENDULUM) -> Array:
    """J(q), shape (1, 1)."""
    return np.array([[p.a * np.cos(q[0])]])


def mass_matrix(q: Array, p: Parameters = PENDULUM) -> Array:
    """M, shape (1, 1), kg m^2; it does not depend on q."""
    return np.array([[p.I + p.m * p.l**2]])


def coriolis(q: Array, dq: Array, p: Parameters = PENDULUM) -> Array:
    """C = 0, shape (1, 1): one joint has no velocity coupling."""
    return np.zeros((1, 1))


def gravity_torque(q: Array, p: Parameters = PENDULUM) -> Array:
    """The torque g(q) that holds the pendulum still, shape (1,), N m."""
    return np.array([p.m * p.g_0 * p.l * np.sin(q[0])])
