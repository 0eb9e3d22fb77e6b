"""The most that a robot's controller takes of a commanded velocity."""

from __future__ import annotations

from typing import final

import casadi as ca

from dmframe.block import AbstractBlock, Diagonal, Equations, Input, Output, Positive, Side, Signals


@final
class CommandLimits(AbstractBlock):
    r"""Cuts each joint's commanded velocity off at its limit.

    .. math::

        \dot q_{lim}      &= \min(\max(\dot q_c, -v_{max}), v_{max})   \tag{1} \\
        \mathrm{excess}   &= \dot q_c - \dot q_{lim}   \tag{2}

    The limits :math:`v_{max}` are those of the robot's URDF, unless `speed` says others. The servo integrates what it
    gets: its q_c is the integral of :math:`\dot q_{lim}`. A run tells where something was cut off.

    Parameters
    ----------
    speed : diagonal (n,), rad/s, > 0
        Limits of the joints; without it, those of the robot's URDF.

    Notes
    -----
    Not for: a maker who slows all joints down together so that the direction is kept. A commanded position is not
    limited.

    References
    ----------
    [Siciliano2009]_ Section 8.1.
    """

    side = Side.PLANT
    uses_robot = True
    inputs = (Input("dq_c", "n", "rad/s"),)
    outputs = (
        Output("dq_lim", "n", "rad/s", instead_of="dq_c"),
        Output("excess", "n", "rad/s", notice="a commanded velocity is beyond its limit, and cut off"),
    )

    speed: Diagonal | None = Positive("n", "rad/s", default=None)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        speed = p.speed if "speed" in p else p.robot.velocity_limits
        limited = ca.fmin(ca.fmax(u.dq_c, -speed), speed)
        return Equations({"dq_lim": limited, "excess": u.dq_c - limited})
