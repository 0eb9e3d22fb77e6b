"""Stribeck, direction-dependent and load-dependent joint friction."""

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
    Real,
    Scalar,
    Side,
    Signals,
)


@final
class StribeckFriction(AbstractBlock):
    r"""Additional joint friction: at low speed (Stribeck effect), in one direction, and by load; as a motor voltage.

    It is added to the friction of `manipulator`:

    .. math::

        \tau_{rub} &= \mathrm{sticking} \exp(-(\dot q / \mathrm{velocity})^2) \phi(\dot q)
                      + \mathrm{uneven}\, \phi(\dot q)^2
                      + \mathrm{per\_torque}\, \mathrm{abs}(K u)\, \phi(\dot q)   \tag{1} \\
        u_{left}   &= u - K^{-1} \tau_{rub}   \tag{2}

    with :math:`\phi(v) = \tanh(v / v_0)`, as in the robot's Coulomb friction. No regressor has a column for it.

    The last term is friction in the gears, which grows with the torque that they transmit; the motor's torque
    :math:`K u` represents it. A joint of efficiency :math:`\eta` that is driven by its motor has about
    :math:`\mathrm{per\_torque} = 1 - \eta`.

    Parameters
    ----------
    sticking : diagonal (n,), N m, >= 0
        Difference between friction at very low and at high speed: the Stribeck effect.
    velocity : scalar, rad/s, > 0
        Velocity at which :math:`1/e` of this difference remains.
    uneven : diagonal (n,), N m
        Difference between friction forwards and the mean of both directions.
    per_torque : diagonal (n,), >= 0
        Friction torque per motor torque; below 1.

    Notes
    -----
    Not for: static friction that holds a joint at rest, since the model has no friction at zero velocity; or friction
    that depends on pose or temperature.

    References
    ----------
    [ArmstrongHelouvry1994]_ Section 2, for the Stribeck curve.
    """

    side = Side.PLANT
    uses_robot = True
    inputs = (Input("u", "n", "V"), Input("K", "n", "N m/V"), Input("dq", "n", "rad/s"))
    outputs = (Output("u_left", "n", "V", instead_of="u"),)

    sticking: Diagonal = NonNegative("n", "N m", default=0.0)
    velocity: Scalar = Positive("", "rad/s", default=0.05)
    uneven: Diagonal = Real("n", "N m", default=0.0)
    per_torque: Diagonal = NonNegative("n", default=0.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        phi, slow = p.robot.coulomb(u.dq), u.dq / p.velocity
        tau_rub = p.sticking * ca.exp(-slow * slow) * phi + p.uneven * phi * phi
        tau_rub += p.per_torque * ca.fabs(u.K * u.u) * phi
        return Equations({"u_left": u.u - tau_rub / u.K})
