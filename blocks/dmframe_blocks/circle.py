"""Circular path in the task space."""

from __future__ import annotations

from typing import Literal, final

import casadi as ca

from dmframe.block import TIME, AbstractBlock, Equations, Output, Real, Scalar, Side, Signals, Vector


@final
class Circle(AbstractBlock):
    r"""Circular tool path at constant angular rate.

    .. math::

        x_d = c + r\, (\sin(\omega t + \varphi),\, \cos(\omega t + \varphi))   \tag{1}

    with :math:`c = \mathrm{center}`, :math:`r = \mathrm{radius}`, :math:`\omega = \mathrm{rate}` and
    :math:`\varphi = \mathrm{phase}`, in the two axes of `plane`; a task with two coordinates has one plane only.

    Parameters
    ----------
    center : (m,), m
        Centre of the circle.
    radius : scalar, m
        Radius; with 0 the path is a point.
    rate : scalar, rad/s
        Angular rate. The speed along the path is radius times rate.
    phase : scalar, rad
        Initial angle on the circle.
    plane : xy, xz or yz
        The plane in which the circle lies.

    References
    ----------
    [WangTAC2020]_ Section V.
    """

    side = Side.SOURCE
    inputs = (TIME,)
    outputs = (Output("x_d", "m", "m"),)

    center: Vector = Real("m", "m", spread=False)
    radius: Scalar = Real("", "m")
    rate: Scalar = Real("", "rad/s")
    phase: Scalar = Real("", "rad", default=0.0)
    plane: Literal["xy", "xz", "yz"] = "xy"

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        m = p.center.numel()
        first, second = ("xyz".index(axis) for axis in self.plane) if m == 3 else (0, 1)
        angle = p.rate * u.t + p.phase
        e = ca.DM.eye(m)
        x_d = p.center + p.radius * (e[:, first] * ca.sin(angle) + e[:, second] * ca.cos(angle))
        return Equations(outputs={"x_d": x_d})
