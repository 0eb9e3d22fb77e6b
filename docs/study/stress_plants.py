"""Robots and a path for ``stress.py``."""

from __future__ import annotations

from typing import final

import casadi as ca

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.linalg import solve_spd
from dmframe.block.parameter import Diagonal, NonNegative, Positive, Real, Scalar, Vector
from dmframe.block.port import TIME, Access, Input, Output, Side, State


@final
class GearedArm(AbstractBlock):
    """A rigid arm with rotors: each adds an inertia to its own joint only."""

    side = Side.PLANT
    uses_robot = True
    inputs = (Input("u", "n", "V"),)
    outputs = (
        Output("q", "n", "rad", Access.MEASURED),
        Output("dq", "n", "rad/s", Access.MEASURED, derivative_of="q"),
        Output("x", "m", "m", Access.MEASURED),
        Output("g", "n", "N m"),
        Output("K", "n", "N m/V"),
        Output("B", "n", "N m s/rad"),
        Output("D", "n", "N m"),
    )
    states = (State("q", "n", "rad"), State("dq", "n", "rad/s"))

    rotor: Diagonal = NonNegative("n", "kg m^2")
    viscous: Diagonal = NonNegative("n", "N m s/rad")
    coulomb: Diagonal = NonNegative("n", "N m")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The acceleration."""
        robot, still = p.robot, ca.DM.zeros(p.robot.n)
        needed = robot.inverse_dynamics(x.q, x.dq, x.dq, still) + p.viscous * x.dq + p.coulomb * robot.coulomb(x.dq)
        ddq = solve_spd(robot.mass_matrix(x.q) + ca.diag(p.rotor), u.u - needed)
        outputs = {"q": x.q, "dq": x.dq, "x": robot.position(x.q), "g": robot.gravity_torque(x.q)}
        truths = {"K": ca.DM.ones(robot.n), "B": p.viscous, "D": p.coulomb}
        return Equations({**outputs, **truths}, rates={"q": x.dq, "dq": ddq})


@final
class PoseFriction(AbstractBlock):
    """Friction that varies with the joint angle, in addition to that of the arm."""

    side = Side.PLANT
    uses_robot = True
    inputs = (
        Input("u", "n", "V"),
        Input("K", "n", "N m/V"),
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
    )
    outputs = (Output("u_left", "n", "V", instead_of="u"),)

    size: Diagonal = NonNegative("n", "N m")
    waves: Scalar = Positive()

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """`waves` waves a radian."""
        tau = p.size * ca.sin(2 * ca.pi * p.waves * u.q) * p.robot.coulomb(u.dq)
        return Equations({"u_left": u.u - tau / u.K})


@final
class MotorEncoders(AbstractBlock):
    """Measures the motors of elastic joints; controllers have no other measurement of the joints."""

    side = Side.PLANT
    uses_robot = True
    inputs = (
        Input("theta", "n", "rad"),
        Input("dtheta", "n", "rad/s"),
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
        Input("x", "m", "m"),
    )
    outputs = (
        Output("q_motor", "n", "rad", Access.MEASURED, instead_of="q"),
        Output("dq_motor", "n", "rad/s", Access.MEASURED, derivative_of="q_motor", instead_of="dq"),
        Output("x_motor", "m", "m", Access.MEASURED, instead_of="x"),
    )

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """Pose, velocity, and the tool position without springs."""
        return Equations({"q_motor": u.theta, "dq_motor": u.dtheta, "x_motor": p.robot.position(u.theta)})


@final
class StopAndGo(AbstractBlock):
    """A circle with motion during half of each `period`, and a stop during the other half."""

    side = Side.SOURCE
    inputs = (TIME,)
    outputs = (Output("x_d", "m", "m"),)

    center: Vector = Real("m", "m", spread=False)
    radius: Scalar = Real("", "m")
    rate: Scalar = Real("", "rad/s")
    period: Scalar = Positive("", "s")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """Each motion begins and ends with zero velocity and acceleration; `rate` is the mean over both halves."""
        done = ca.floor(u.t / p.period)
        s = ca.fmin(2 * (u.t / p.period - done), 1)
        angle = p.rate * p.period * (done + s * s * s * (10 - 15 * s + 6 * s * s))
        return Equations(outputs={"x_d": p.center + p.radius * ca.vertcat(ca.sin(angle), ca.cos(angle), 0)})
