"""A circle in the task space."""

from __future__ import annotations

from typing import Literal, final

import casadi as ca

from dmframe.block import TIME, AbstractBlock, Equations, Output, Real, Scalar, Side, Signals, Vector


@final
class Circle(AbstractBlock):
    r"""The tool's path is a circle, run through at a constant rate.

    .. math::

        x_d = c + r\, (\sin(\omega t + \varphi),\, \cos(\omega t + \varphi))   \tag{1}

    with :math:`c = \mathrm{center}`, :math:`r = \mathrm{radius}`, :math:`\omega = \mathrm{rate}` and
    :math:`\varphi = \mathrm{phase}`, in the two axes of `plane`; a task of two coordinates has only the one plane.

    Parameters
    ----------
    center : (m,), m
        The middle of the circle.
    radius : scalar, m
        At 0 the path is a point.
    rate : scalar, rad/s
        Angular frequency. The speed along the path is radius times as much.
    phase : scalar, rad
        Where on the circle the path begins.
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
