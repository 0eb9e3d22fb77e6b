"""Torque limits of the drives."""

from __future__ import annotations

from typing import final

import casadi as ca

from dmframe.block import AbstractBlock, Diagonal, Equations, Input, Output, Positive, Side, Signals


@final
class TorqueLimits(AbstractBlock):
    r"""Saturates the voltage of each motor at its torque limit.

    .. math::

        u_{lim}           &= K^{-1} \min(\max(K u, -\tau_{max}), \tau_{max})   \tag{1} \\
        \tau_{excess}     &= K (u - u_{lim})   \tag{2}

    The limits :math:`\tau_{max}` are those of the robot's URDF, unless `torque` is given. The block is between servo
    and arm. The servo has no anti-windup: its integrator continues during saturation. A run reports saturation.

    Parameters
    ----------
    torque : diagonal (n,), N m, > 0
        Torque limits of the joints; by default those of the robot's URDF.

    Notes
    -----
    Not for: a limit that decreases with velocity, thermal limits, or a servo with anti-windup.

    References
    ----------
    [Siciliano2009]_ Section 5.2.
    """

    side = Side.PLANT
    uses_robot = True
    inputs = (Input("u", "n", "V"), Input("K", "n", "N m/V"))
    outputs = (
        Output("u_lim", "n", "V", instead_of="u"),
        Output("tau_excess", "n", "N m", notice="a motor's torque is beyond its limit, and is saturated"),
    )

    torque: Diagonal | None = Positive("n", "N m", default=None)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        torque = p.torque if "torque" in p else p.robot.effort_limits
        limited = ca.fmin(ca.fmax(u.K * u.u, -torque), torque) / u.K
        return Equations({"u_lim": limited, "tau_excess": u.K * (u.u - limited)})
