"""Joints that twist between motor and link."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

from dmframe.block import (
    SX,
    AbstractBlock,
    Diagonal,
    Equations,
    Input,
    NonNegative,
    Output,
    Positive,
    Side,
    Signals,
    State,
)


@final
class ElasticJoints(AbstractBlock):
    r"""Puts a spring between each motor and its link, and the motor's inertia before it.

    .. math::

        \mathrm{inertia}\, \ddot \theta &= K u - K u_{link}   \tag{1} \\
        u_{link} &= K^{-1} (\mathrm{stiffness}\, (\theta - q) + \mathrm{damping}\, (\dot \theta - \dot q))   \tag{2}

    The arm is driven by the springs. A servo reads its motors in most robots: wire `servo.q` to `theta` and
    `servo.dq` to `dtheta`; without these wires it reads the links, as one with a second encoder does. At the start the
    springs hold the robot against gravity.

    Parameters
    ----------
    stiffness : diagonal (n,), N m/rad, > 0
        Of the gears, seen from the joint.
    damping : diagonal (n,), N m s/rad, >= 0
        Of the gears.
    inertia : diagonal (n,), kg m^2, > 0
        Of motor and gear, seen from the joint: the rotor's times the square of the ratio.

    Notes
    -----
    The friction of `manipulator` stays with the links. Not for: backlash, or a motor that the links turn by their own
    motion in space, which the model leaves out.

    References
    ----------
    [Spong1987]_
    """

    side = Side.PLANT
    inputs = (
        Input("u", "n", "V"),
        Input("K", "n", "N m/V"),
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
    )
    outputs = (
        Output("u_link", "n", "V", instead_of="u"),
        Output("theta", "n", "rad"),
        Output("dtheta", "n", "rad/s", derivative_of="theta"),
    )
    states = (State("theta", "n", "rad"), State("dtheta", "n", "rad/s"))
    truth = (Input("g", "n", "N m"),)

    stiffness: Diagonal = Positive("n", "N m/rad")
    damping: Diagonal = NonNegative("n", "N m s/rad", default=0.0)
    inertia: Diagonal = Positive("n", "kg m^2")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        twist = p.stiffness * (x.theta - u.q) + p.damping * (x.dtheta - u.dq)
        return Equations(
            outputs={"u_link": twist / u.K, "theta": x.theta, "dtheta": x.dtheta},
            rates={"theta": x.dtheta, "dtheta": (u.K * u.u - twist) / p.inertia},
        )

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """At rest, the springs wound up by gravity."""
        return {"theta": u.q + truth.g / p.stiffness, "dtheta": 0 * u.dq}
