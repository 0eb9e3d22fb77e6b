"""Joint elasticity between motor and link."""

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
    r"""Adds a spring between each motor and its link, and the inertia of the motor.

    .. math::

        \mathrm{inertia}\, \ddot \theta &= K u - K u_{link}   \tag{1} \\
        u_{link} &= K^{-1} (\mathrm{stiffness}\, (\theta - q) + \mathrm{damping}\, (\dot \theta - \dot q))   \tag{2}

    The springs drive the arm. In most robots the servo measures the motors: wire `servo.q` to `theta` and `servo.dq`
    to `dtheta`. Without these wires it measures the links, like a servo with a second encoder. Initially the springs
    balance gravity.

    Parameters
    ----------
    stiffness : diagonal (n,), N m/rad, > 0
        Stiffness of the gears, referred to the joint.
    damping : diagonal (n,), N m s/rad, >= 0
        Damping of the gears.
    inertia : diagonal (n,), kg m^2, > 0
        Inertia of motor and gear, referred to the joint: that of the rotor times the square of the gear ratio.

    Notes
    -----
    The friction of `manipulator` acts on the links. Not for: backlash, or the inertial coupling between rotors and the
    motion of the links, which the model neglects.

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
        """At rest, with the springs deflected by gravity."""
        return {"theta": u.q + truth.g / p.stiffness, "dtheta": 0 * u.dq}
