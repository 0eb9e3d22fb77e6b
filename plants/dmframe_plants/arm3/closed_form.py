r"""The planar three-link arm in closed form, joint angles q = (q_1, q_2, q_3).

In the links' absolute angles :math:`\theta = T q`, T lower triangular of ones, the equations are short,

.. math::

    M_{ij} = k_{ij} \cos(\theta_i - \theta_j), \quad
    C_{ij} = k_{ij} \sin(\theta_i - \theta_j) \dot\theta_j, \quad
    g_i = h_i g_0 \cos\theta_i

and :math:`T^\top (\cdot) T` transforms them to joint angles. A constant T transforms the Christoffel matrix of one set
of angles into that of the other. Notation of [Siciliano2009]_: link lengths a_i, centres of mass at l_i, masses m_i,
inertias I_i about the centres of mass. The same equations with more or fewer links describe any planar arm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

T = np.tril(np.ones((3, 3)))


@final
@dataclass(frozen=True)
class Parameters:
    """Parameters of the arm, one value per link; the defaults are those of `arm3.urdf`."""

    a: tuple[float, ...] = (0.45, 0.4, 0.22)  # [m]
    l: tuple[float, ...] = (0.2, 0.17, 0.1)  # noqa: E741 - the textbook's letter [m]
    m: tuple[float, ...] = (6.0, 3.5, 1.5)  # [kg]
    I: tuple[float, ...] = (0.12, 0.05, 0.006)  # noqa: E741 - the textbook's letter [kg m^2]
    g_0: float = 9.81  # [m/s^2]


ARM3 = Parameters()


def position(q: Array, p: Parameters = ARM3) -> Array:
    """The tool's (x, z), shape (2,), m."""
    theta = T @ q
    return np.array([np.dot(p.a, np.cos(theta)), np.dot(p.a, np.sin(theta))])


def jacobian(q: Array, p: Parameters = ARM3) -> Array:
    """J(q), shape (2, 3)."""
    theta, a = T @ q, np.array(p.a)
    J: Array = np.array([-a * np.sin(theta), a * np.cos(theta)]) @ T
    return J


def mass_matrix(q: Array, p: Parameters = ARM3) -> Array:
    """M(q), shape (3, 3), kg m^2."""
    theta = T @ q
    M: Array = T.T @ (_coupling(p) * np.cos(theta[:, None] - theta[None, :])) @ T
    return M


def coriolis(q: Array, dq: Array, p: Parameters = ARM3) -> Array:
    """The Christoffel matrix C(q, dq), shape (3, 3)."""
    theta, dtheta = T @ q, T @ dq
    C: Array = T.T @ (_coupling(p) * np.sin(theta[:, None] - theta[None, :]) * dtheta[None, :]) @ T
    return C


def gravity_torque(q: Array, p: Parameters = ARM3) -> Array:
    """The torque g(q) that holds the arm still, shape (3,), N m."""
    torque: Array = T.T @ (_first_moments(p) * p.g_0 * np.cos(T @ q))
    return torque


def _first_moments(p: Parameters) -> Array:
    """h_i = m_i l_i + (m_{i+1} + ... + m_3) a_i: first moment of link i and of the masses that it carries."""
    return np.array([p.m[i] * p.l[i] + sum(p.m[i + 1 :]) * p.a[i] for i in range(3)])


def _coupling(p: Parameters) -> Array:
    """k_ii = I_i + m_i l_i^2 + (m_{i+1} + ... + m_3) a_i^2, and k_ij = a_i h_j for i < j."""
    h = _first_moments(p)
    k = np.diag([p.I[i] + p.m[i] * p.l[i] ** 2 + sum(p.m[i + 1 :]) * p.a[i] ** 2 for i in range(3)])
    for i in range(3):
        for j in range(i + 1, 3):
            k[i, j] = k[j, i] = p.a[i] * h[j]
    return k
