"""Velocity limits of a robot's command interface."""

from __future__ import annotations

from typing import final

import casadi as ca

from dmframe.block import AbstractBlock, Diagonal, Equations, Input, Output, Positive, Side, Signals


@final
class CommandLimits(AbstractBlock):
    r"""Saturates each joint's commanded velocity at its limit.

    .. math::

        \dot q_{lim}      &= \min(\max(\dot q_c, -v_{max}), v_{max})   \tag{1} \\
        \mathrm{excess}   &= \dot q_c - \dot q_{lim}   \tag{2}

    The limits :math:`v_{max}` are those of the robot's URDF, unless `speed` is given. The servo integrates the limited
    command: its q_c is the integral of :math:`\dot q_{lim}`. A run reports saturation.

    Parameters
    ----------
    speed : diagonal (n,), rad/s, > 0
        Velocity limits of the joints; by default those of the robot's URDF.

    Notes
    -----
    Not for: a robot that scales all joints together to keep the direction. A commanded position is not limited.

    References
    ----------
    [Siciliano2009]_ Section 8.1.
    """

    side = Side.PLANT
    uses_robot = True
    inputs = (Input("dq_c", "n", "rad/s"),)
    outputs = (
        Output("dq_lim", "n", "rad/s", instead_of="dq_c"),
        Output("excess", "n", "rad/s", notice="a commanded velocity is beyond its limit, and is saturated"),
    )

    speed: Diagonal | None = Positive("n", "rad/s", default=None)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        speed = p.speed if "speed" in p else p.robot.velocity_limits
        limited = ca.fmin(ca.fmax(u.dq_c, -speed), speed)
        return Equations({"dq_lim": limited, "excess": u.dq_c - limited})
