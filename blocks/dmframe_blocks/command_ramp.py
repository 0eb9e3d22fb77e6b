"""How a robot's controller goes from one commanded velocity to the next."""

from __future__ import annotations

from typing import final

import casadi as ca

from dmframe.block import AbstractBlock, Diagonal, Equations, Input, Output, Positive, Scalar, Side, Signals, State


@final
class CommandRamp(AbstractBlock):
    r"""Approaches the commanded velocity with a limited acceleration, and through a filter of first order.

    .. math::

        \ddot q_{ramp} = (\dot q_c - \dot q_{ramp}) / \mathrm{time\_constant}   \tag{1}

    and with an acceleration

    .. math::

        \ddot q_{ramp} = \min(\max((\dot q_c - \dot q_{ramp}) / \mathrm{time\_constant}, -\mathrm{acceleration}),
            \mathrm{acceleration})   \tag{2}

    Far from the command it is a ramp of that slope, as of Universal Robots' speedj, and
    near to it the filter. At the start the robot is at rest.

    Parameters
    ----------
    acceleration : diagonal (n,), rad/s^2, > 0
        Largest rate of the velocity that the servo is given; without it there is no limit.
    time_constant : scalar, s, > 0
        Of the filter. With a ramp, take the period of the maker's own loop.

    Notes
    -----
    Not for: a maker who limits the leading axis and scales the others with it, as speedj does, so that all joints
    arrive together: here each joint has its own ramp.

    References
    ----------
    [URScript2024]_ speedj.
    """

    side = Side.PLANT
    inputs = (Input("dq_c", "n", "rad/s"),)
    outputs = (Output("dq_ramp", "n", "rad/s", instead_of="dq_c"),)
    states = (State("dq_ramp", "n", "rad/s"),)

    acceleration: Diagonal | None = Positive("n", "rad/s^2", default=None)
    time_constant: Scalar = Positive("", "s", default=0.002)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        rate = (u.dq_c - x.dq_ramp) / p.time_constant
        if "acceleration" in p:
            rate = ca.fmin(ca.fmax(rate, -p.acceleration), p.acceleration)
        return Equations({"dq_ramp": x.dq_ramp}, {"dq_ramp": rate})
