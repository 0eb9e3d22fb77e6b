"""Response of a closed servo over a sample by the averaged model: its row, its slope, and the motion by a command."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, NamedTuple, final

import casadi as ca

from dmframe.block import SX, named, solve_spd
from dmframe_blocks._averaged_servo import AveragedServo, Start

_NEWTON: Final = 4
"""Newton steps for predicting the average velocity of a sample with a known command."""


class Ahead(NamedTuple):
    """The samples until a new command acts.

    Columns of known commands and of planned velocities, the first of the last completed sample; the delay, None if it
    is the number of the other columns; and the period.
    """

    commands: SX
    plans: SX
    delay: SX | None
    T: SX


@final
@dataclass(frozen=True)
class Response:
    """The averaged model of `AveragedServo` with the functions of a robot."""

    averaged: AveragedServo
    robot: Any

    def row(self, start: Start, v: SX, command: SX, T: SX, momentum: SX = 1) -> SX:
        """The row of a sample with average velocity v and a command; `momentum` 0 omits the change of momentum."""
        averaged, robot, m = self.averaged, self.robot, start.q + T * v / 2
        target = start.target + T * command / 2
        e = m - target
        change = (averaged.momentum(robot, m, v) - averaged.momentum(robot, start.m_before, start.v_before)) / T
        Y = momentum * change + averaged.others(robot, m, v)
        further = averaged.of_p_pi(command, target)
        return averaged.row(e, start.z + T * e / 2, ca.DM.ones(robot.n), Y, v, robot.coulomb(v), *further)

    def slope(self, theta: SX, q: SX, T: SX) -> SX:
        """S = w M(q)/T by the estimates: the slope of the prediction with respect to velocity due to inertia."""
        units = ca.horzsplit(ca.DM.eye(self.robot.n))
        momenta = ca.horzcat(*(self.averaged.momentum(self.robot, q, unit) for unit in units))
        return self.averaged.inertia(theta, momenta) / T

    def after(
        self, k: int, start: Start, theta: SX, slow: SX, command: SX, v: SX, T: SX, margin: SX
    ) -> tuple[Start, SX]:
        """The start of the sample after the k-th from now, whose command is known, and what theta leaves of it.

        The average velocity is found by Newton's method from v; `slow` is the low-pass filtered residual.
        """
        averaged, robot = self.averaged, self.robot
        S = named(f"S_{k}", self.slope(theta, start.q, T))
        safe = named(f"safe_{k}", averaged.safe(S, margin))
        rises = named(f"rise_{k}", ca.DM.eye(robot.n) + safe * (S + S.T) / 2)

        def left(v: SX) -> SX:
            return command - v - averaged.answer(self.row(start, v, command, T, safe), theta)

        for i in range(1, _NEWTON + 1):
            damped = rises + ca.diag(averaged.damping(theta, v, robot.friction_velocity, T))
            v = named(f"v_{k}_{i}", v + solve_spd(damped, left(v) - slow))
        middle = named(f"m_{k}", start.q + T * v / 2)
        z = named(f"z_{k}", start.z + T * (middle - start.target - T * command / 2))
        target = named(f"target_{k}", start.target + T * command)
        return Start(named(f"q_{k}", start.q + T * v), target, z, middle, v), left(v)

    def when_acting(self, ahead: Ahead, start: Start, slow: SX, share: SX, theta: SX, margin: SX) -> tuple[Start, SX]:
        """The start of the sample in which a new command acts, and the low-pass filtered residual there.

        `share` is T/tau of that filter, zero without one.
        """
        for k in range(1, ahead.commands.shape[1]):
            end, left = self.after(k, start, theta, slow, ahead.commands[:, k], ahead.plans[:, k], ahead.T, margin)
            next_slow = named(f"slow_{k}", slow + share * (left + self.averaged.offset(theta) - slow))
            if ahead.delay is not None:
                over = named(f"over_{k}", ahead.delay < k)
                both = zip((*start, slow), (*end, next_slow), strict=True)
                *parts, next_slow = (named(f"start_{k}_{i}", ca.if_else(over, *pair)) for i, pair in enumerate(both))
                end = Start(*parts)
            start, slow = end, next_slow
        return start, slow
