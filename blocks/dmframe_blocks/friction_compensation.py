"""A maker's compensation of Coulomb friction."""

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
    r"""Adds to the servo's voltage the torque that the maker takes the joints' Coulomb friction for.

    .. math::

        u_{comp} = u + K^{-1} \mathrm{coulomb}\, \tanh(\dot q / \mathrm{velocity})   \tag{1}

    The maker's :math:`\dot q` is the true one. The outer loop is not told. (`manipulator` has the same for gravity and
    viscous friction.)

    Parameters
    ----------
    coulomb : diagonal (n,), N m, >= 0
        What the maker takes it for; more than the joints have, and they are pushed along: the loop may hunt.
    velocity : scalar, rad/s, > 0
        Where the compensation reaches tanh(1) of it. Well above the robot's `friction_velocity`, as makers do against
        chatter, it leaves friction at slow motion.

    Notes
    -----
    Not for: a maker who compensates along the commanded velocity.

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
