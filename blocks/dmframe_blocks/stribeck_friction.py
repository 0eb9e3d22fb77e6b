"""Friction that sticks, and that differs with the direction."""

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
    r"""Takes from the motors' voltage what joints rub more at slow motion, and in one direction.

    It comes on top of the friction of `manipulator`:

    .. math::

        \tau_{rub} &= \mathrm{sticking} \exp(-(\dot q / \mathrm{velocity})^2) \phi(\dot q)
                      + \mathrm{uneven}\, \phi(\dot q)^2   \tag{1} \\
        u_{left}   &= u - K^{-1} \tau_{rub}   \tag{2}

    with :math:`\phi(v) = \tanh(v / v_0)`, as the robot's own Coulomb friction has it. No regressor has a column for it.

    Parameters
    ----------
    sticking : diagonal (n,), N m, >= 0
        How much larger friction is at the slowest motion than at fast motion: the Stribeck effect.
    velocity : scalar, rad/s, > 0
        Where a share of 1/e of it is left.
    uneven : diagonal (n,), N m
        How much larger it is forwards than in the mean of both directions.

    Notes
    -----
    Not for: a joint that is held by friction at rest, since here none is left at velocity zero; or friction that
    changes with the load, the pose or the temperature.

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

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        phi, slow = p.robot.coulomb(u.dq), u.dq / p.velocity
        tau_rub = p.sticking * ca.exp(-slow * slow) * phi + p.uneven * phi * phi
        return Equations({"u_left": u.u - tau_rub / u.K})
