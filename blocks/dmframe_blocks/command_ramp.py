"""Acceleration-limited transition between velocity commands."""

from __future__ import annotations

from typing import final

import casadi as ca

from dmframe.block import AbstractBlock, Diagonal, Equations, Input, Output, Positive, Scalar, Side, Signals, State


@final
class CommandRamp(AbstractBlock):
    r"""Passes the commanded velocity through a first-order filter with limited acceleration.

    .. math::

        \ddot q_{ramp} = (\dot q_c - \dot q_{ramp}) / \mathrm{time\_constant}   \tag{1}

    and with an acceleration limit

    .. math::

        \ddot q_{ramp} = \min(\max((\dot q_c - \dot q_{ramp}) / \mathrm{time\_constant}, -\mathrm{acceleration}),
            \mathrm{acceleration})   \tag{2}

    Far from the command the velocity is a ramp with that slope, as in speedj of Universal Robots; near the command it
    is the filter. The robot starts at rest.

    Parameters
    ----------
    acceleration : diagonal (n,), rad/s^2, > 0
        Largest acceleration of the velocity that the servo receives; by default there is no limit.
    time_constant : scalar, s, > 0
        Time constant of the filter. With a ramp, use the period of the manufacturer's control loop.

    Notes
    -----
    Not for: a robot that limits the leading axis and scales the others with it, as speedj does, so that all joints
    arrive together. Here each joint has its own ramp.

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
