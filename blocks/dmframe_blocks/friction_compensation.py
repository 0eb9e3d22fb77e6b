"""Manufacturer's compensation of Coulomb friction."""

from __future__ import annotations

from typing import final

import casadi as ca

from dmframe.block import (
    AbstractBlock,
    Diagonal,
    Equations,
    Input,
    NonNegative,
    Output,
    Positive,
    Scalar,
    Side,
    Signals,
)


@final
class FrictionCompensation(AbstractBlock):
    r"""Adds the manufacturer's compensation of Coulomb friction to the servo's voltage.

    .. math::

        u_{comp} = u + K^{-1} \mathrm{coulomb}\, \tanh(\dot q / \mathrm{velocity})   \tag{1}

    The manufacturer's :math:`\dot q` is the true one. The outer loop has no information about the compensation.
    `manipulator` has the same option for gravity and viscous friction.

    Parameters
    ----------
    coulomb : diagonal (n,), N m, >= 0
        Compensated friction torque. If it exceeds that of the joints, the net friction is negative, and limit cycles
        (hunting) may occur.
    velocity : scalar, rad/s, > 0
        Velocity at which the compensation is tanh(1) of this torque. Manufacturers choose it well above the robot's
        `friction_velocity` to avoid chatter; friction then remains at low speed.

    Notes
    -----
    Not for: compensation along the commanded velocity.

    References
    ----------
    [Siciliano2009]_ Section 7.2.
    """

    side = Side.PLANT
    inputs = (Input("u", "n", "V"), Input("K", "n", "N m/V"), Input("dq", "n", "rad/s"))
    outputs = (Output("u_comp", "n", "V", instead_of="u"),)

    coulomb: Diagonal = NonNegative("n", "N m")
    velocity: Scalar = Positive("", "rad/s", default=0.02)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations({"u_comp": u.u + p.coulomb * ca.tanh(u.dq / p.velocity) / u.K})
