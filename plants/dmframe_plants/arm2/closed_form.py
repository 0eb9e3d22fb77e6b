r"""The planar two-link arm in closed form, joint angles q = (q_1, q_2).

In the notation of [Siciliano2009]_ section 7.3.2 without the motors: link lengths a_i, centres of mass at l_i from the
joints, masses m_i and inertias I_i about the centres of mass. q_1 is measured from the horizontal, q_2 from link 1.
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
    """Parameters of the arm; the defaults are those of `arm2.urdf`."""

    a_1: Any = 0.45  # [m]
    a_2: Any = 0.4  # [m]
    l_1: Any = 0.2  # [m]
    l_2: Any = 0.17  # [m]
    m_1: Any = 6.0  # [kg]
    m_2: Any = 3.5  # [kg]
    I_1: Any = 0.12  # [kg m^2]
    I_2: Any = 0.05  # [kg m^2]
    g_0: Any = 9.81  # [m/s^2]


ARM2 = Parameters()


def position(q: Array, p: Parameters = ARM2) -> Array:
    """The tool's (x, z), shape (2,), m."""
    return np.array(
        [
            p.a_1 * np.cos(q[0]) + p.a_2 * np.cos(q[0] + q[1]),
            p.a_1 * np.sin(q[0]) + p.a_2 * np.sin(q[0] + q[1]),
        ]
    )


def jacobian(q: Array, p: Parameters = ARM2) -> Array:
    """J(q), shape (2, 2)."""
    s_1, s_12 = np.sin(q[0]), np.sin(q[0] + q[1])
    c_1, c_12 = np.cos(q[0]), np.cos(q[0] + q[1])
    return np.array(
        [
            [-p.a_1 * s_1 - p.a_2 * s_12, -p.a_2 * s_12],
            [p.a_1 * c_1 + p.a_2 * c_12, p.a_2 * c_12],
        ]
    )


def mass_matrix(q: Array, p: Parameters = ARM2) -> Array:
    """M(q), shape (2, 2), kg m^2."""
    c_2 = np.cos(q[1])
    b_11 = p.I_1 + p.m_1 * p.l_1**2 + p.I_2 + p.m_2 * (p.a_1**2 + p.l_2**2 + 2 * p.a_1 * p.l_2 * c_2)
    b_12 = p.I_2 + p.m_2 * (p.l_2**2 + p.a_1 * p.l_2 * c_2)
    b_22 = p.I_2 + p.m_2 * p.l_2**2
    return np.array([[b_11, b_12], [b_12, b_22]])


def coriolis(q: Array, dq: Array, p: Parameters = ARM2) -> Array:
    """The Christoffel matrix C(q, dq), shape (2, 2)."""
    h = -p.m_2 * p.a_1 * p.l_2 * np.sin(q[1])
    return np.array([[h * dq[1], h * (dq[0] + dq[1])], [-h * dq[0], 0.0]])


def gravity_torque(q: Array, p: Parameters = ARM2) -> Array:
    """The torque g(q) that holds the arm still, shape (2,), N m."""
    g_2 = p.m_2 * p.l_2 * p.g_0 * np.cos(q[0] + q[1])
    return np.array([(p.m_1 * p.l_1 + p.m_2 * p.a_1) * p.g_0 * np.cos(q[0]) + g_2, g_2])
