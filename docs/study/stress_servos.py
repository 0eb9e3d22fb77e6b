"""Servos that differ from the controllers' models, for ``stress.py``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.certificate import SX
from dmframe.block.parameter import Diagonal, Positive, Scalar
from dmframe.block.port import Access, Input, Output, Side, State


@final
class VelocityServo(AbstractBlock):
    """P servo of the joint velocities: it has no target position, and the robot sags under gravity."""

    side = Side.PLANT
    inputs = (Input("dq", "n", "rad/s"), Input("dq_c", "n", "rad/s"))
    outputs = (Output("u", "n", "V"),)

    K_P: Diagonal = Positive("n", "V s/rad")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The voltage."""
        return Equations(outputs={"u": -p.K_P * (u.dq - u.dq_c)})


class AbstractPositionServo(AbstractBlock):
    """PID servo of the joint positions, with equations of the subclass."""

    side = Side.PLANT
    inputs = (
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
        Input("dq_c", "n", "rad/s"),
    )
    outputs = (Output("q_c", "n", "rad", Access.MEASURED), Output("u", "n", "V"))
    states = (State("q_c", "n", "rad"), State("i", "n", "rad s"))
    truth = (Input("g", "n", "N m"), Input("K", "n", "N m/V"))

    K_D: Diagonal = Positive("n", "V s/rad")
    K_P: Diagonal = Positive("n", "V/rad")
    K_I: Diagonal = Positive("n", "V/(rad s)")

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """At rest, with the integrator balancing gravity."""
        return {"q_c": u.q, "i": -truth.g / (truth.K * p.K_I)}


@final
class DriftingServo(AbstractPositionServo):
    """PID servo of the joint positions with a target that integrates a fraction of the commands."""

    share: Scalar = Positive(default=0.99)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The voltage, and the rate of the target."""
        voltage = -p.K_D * (u.dq - u.dq_c) - p.K_P * (u.q - x.q_c) - p.K_I * x.i
        return Equations({"q_c": x.q_c, "u": voltage}, rates={"q_c": p.share * u.dq_c, "i": u.q - x.q_c})


@final
class FilteredServo(AbstractPositionServo):
    """PID servo of the joint positions that filters the velocity error."""

    states = (*AbstractPositionServo.states, State("slip", "n", "rad/s"))

    time_constant: Scalar = Positive("", "s")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The voltage, from the filtered velocity error."""
        voltage = -p.K_D * x.slip - p.K_P * (u.q - x.q_c) - p.K_I * x.i
        behind = (u.dq - u.dq_c - x.slip) / p.time_constant
        return Equations({"q_c": x.q_c, "u": voltage}, rates={"q_c": u.dq_c, "i": u.q - x.q_c, "slip": behind})


@final
class HurriedServo(AbstractPositionServo):
    """PID servo of the joint positions with a fast clock: `pace` of its seconds pass in one second."""

    pace: Scalar = Positive()

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The voltage, with integration and velocity in the servo's own time."""
        voltage = -p.K_D * (u.dq / p.pace - u.dq_c) - p.K_P * (u.q - x.q_c) - p.K_I * x.i
        return Equations({"q_c": x.q_c, "u": voltage}, rates={"q_c": p.pace * u.dq_c, "i": p.pace * (u.q - x.q_c)})
