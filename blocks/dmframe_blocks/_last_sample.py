"""The last completed sample of a sampled inverse: its command, average velocity, row and output."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, final

import casadi as ca

from dmframe.block import SX, Signals, named
from dmframe_blocks._averaged_servo import AveragedServo, Start
from dmframe_blocks._identified_delay import Aimed, Delayed, acting, with_shorter_delay
from dmframe_blocks._sample_response import Response


class Measured(Delayed, Protocol):
    """The options of a block that determine the measurements of a sample."""

    @property
    def filtered(self) -> bool:
        """Whether rows and outputs are high-pass filtered."""

    @property
    def echoed(self) -> bool:
        """Whether the robot reports its target."""

    @property
    def time_stamps(self) -> bool:
        """Whether the measurement times are known."""


@final
@dataclass(frozen=True)
class LastSample:
    """A completed sample.

    Parameters
    ----------
    T, command, v
        Length, command that acted, and average velocity.
    aimed
        The target at the beginning, and the sum of the errors before it.
    psi, y
        Row and output.
    slow
        The low-pass filtered row and output before this sample; None without a filter.
    h, g
        Row and output, high-pass filtered if the block filters.
    """

    T: SX
    command: SX
    v: SX
    aimed: Aimed
    psi: SX
    y: SX
    slow: tuple[SX, SX] | None
    h: SX
    g: SX

    def filtered(self, averaged: AveragedServo, psi_slow: SX, y_slow: SX, share: SX) -> tuple[SX, SX]:
        """The low-pass filtered row and output after this sample; `share` is T/tau."""
        psi = named("psi_next", averaged.changing(psi_slow + share * (self.psi - psi_slow)))
        return psi, named("y_next", y_slow + share * (self.y - y_slow))

    def row_and_goal(self, response: Response, u: Signals, x: Signals, settling: SX, u_max: SX) -> tuple[SX, SX]:
        """The row and output for the estimator: zero for joints whose command was clipped."""
        active = named("active", (x.count * u.T > settling) * (ca.fabs(self.command) < u_max))
        return response.averaged.of_joint(active) * self.h, active * self.g


def length_of(block: Measured, u: Signals, x: Signals) -> SX:
    """Length of the last sample."""
    return named("T_over", u.t - x.t_before) if block.time_stamps else u.T


def last_sample(block: Measured, response: Response, u: Signals, x: Signals) -> LastSample:
    """The last sample of a block with the inputs and states of `SampledInverse`."""
    T = length_of(block, u, x)
    command = named("u_applied", (u.q_echo - x.q_aim) / T if block.echoed else acting(block, u, x.queue)[:, 0])
    v, aimed = named("v", (u.q - x.q_before) / T), Aimed(x.q_aim, x.z)
    if block.delay_up_to is not None and not block.echoed:
        aimed = with_shorter_delay(aimed, x.queue, u.delay_hat, T)
    psi = named("psi", response.row(Start(x.q_before, *aimed, x.m_before, x.v_before), v, command, T))
    y = named("y_row", command - v)
    if not block.filtered:
        return LastSample(T, command, v, aimed, psi, y, None, psi, y)
    slow = x.psi_slow, x.y_slow
    if block.delay_up_to is not None:  # the filter begins with the first sample of an identified delay
        begins = x.count < 1
        psi_slow = ca.if_else(begins, response.averaged.changing(psi), x.psi_slow)
        slow = named("psi_slow_now", psi_slow), named("y_slow_now", ca.if_else(begins, y, x.y_slow))
    h, g = named("h_row", psi - slow[0]), named("g_row", y - slow[1])
    return LastSample(T, command, v, aimed, psi, y, slow, h, g)
