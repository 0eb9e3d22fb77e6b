"""Limit of the change of a command, with evidence whether the channel follows larger changes.

A ramp with the acceleration a_max would turn the commands u into

    r = r + clip(u - r, -a_max T, a_max T)

The lag u - v of the joints' average velocity v is u - r + s behind it, and s without it, with the servo's own lag s.
The evidence is the integral of |v - r|^2 - |v - u|^2 over time: with a ramp it falls by |r - u|^2, and rises by that
without one, if s is small. If the path needs more than a_max by A, |r - u| = A t grows with time, and s lowers the
evidence by at most 4 s^3/(3 A), until A t = 2 s. A ramp is therefore taken as shown by evidence below -doubt.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import casadi as ca

from dmframe.block import SX, Signals, State, clip, named
from dmframe_blocks._identified_delay import Delayed, acting

DOUBT: Final = 1e-3
"""Default of `doubt` [rad^2/s]: more than the lag of 0.09 rad/s of a servo causes with A = 1 rad/s^2."""

STATES: Final = (
    State("path_before", "n", "rad/s", sampled=True, optional=True),
    State("ramped", "n", "rad/s", sampled=True, optional=True),
    State("gaps", "n d", "rad/s", sampled=True, optional=True, recorded=False),
    State("evidence", "", "rad^2/s", sampled=True, optional=True),
)
"""Velocity along the path, the output r of the ramp, its differences r - u in the queue of commands, the evidence."""


class Limited(NamedTuple):
    """The change of the command within its limits, and the states, of which `begun` begin with the delay."""

    change: SX
    kept: Mapping[str, SX]
    begun: Mapping[str, SX]


def limited(block: Delayed, u: Signals, x: Signals, p: Signals, wished: SX, lag: SX) -> Limited:
    """The change towards the wished command; `lag` is u - v of the last completed sample.

    Unless the evidence is below -doubt, or the delay is unknown, a path that needs more than a half of a_max gets that,
    and as much again for corrections.
    """
    if "a_max" not in p:
        return Limited(wished - x.queue[:, -1], {}, {})
    room, known = p.a_max * u.T, 1 if block.delay_up_to is None else u.identified
    gap = acting(block, u, x.gaps)[:, 0]
    evidence = named("evidence_new", x.evidence + u.T * ca.dot(gap, gap + 2 * lag))
    follows = named("follows", known * (x.count > 1) * (evidence + p.doubt >= 0))
    needed = named("needed", follows * (u.dq_path - x.path_before))
    more = ca.fmax(room / 2, ca.fabs(needed))
    low, high = ca.fmin(-room, needed - more), ca.fmax(room, needed + more)
    change = named("change", ca.fmin(ca.fmax(wished - x.queue[:, -1], low), high))
    sent = x.queue[:, -1] + change
    ramped = named("ramped_new", x.ramped + clip(sent - x.ramped, room))
    kept = {"path_before": u.dq_path, "ramped": ramped}
    return Limited(change, kept, {"gaps": ca.horzcat(x.gaps[:, 1:], ramped - sent), "evidence": evidence})
