"""Limit of the change of a command, with evidence whether the channel follows larger changes.

A ramp with the acceleration a_max would turn the commands u into

    r = r + clip(u - r, -a_max T, a_max T)

A servo lags behind its command, as a ramp does, and the lag is not known. So the average velocity v of each joint is
compared with those of filters 1/(1 + tau s), for tau = 0 and each of `RATIOS` times the parameter `lag_time`, once
with the input u and once with r. The sums

    S_u(tau) = integral of |v - F_tau u|^2 over time,    S_r(tau) = integral of |v - F_tau r|^2

grow alike as long as r = u. Where they differ, one of them is the larger one, and the evidence

    sum over the joints of min_tau S_r(tau) - min_tau S_u(tau)

compares a ramp and a lag with a lag alone. If v = F_tau u + w with one of these tau, then min S_u is at most the
integral of |w|^2, and so the evidence is at least minus that.

The residuals of the better hypothesis have the mean square

    s^2 = min(sum of min S_r, sum of min S_u) / max(t, evidence_time)

at the time t after the delay is known. If they are Gaussian, and correlated over tau_c, the logarithm of the
likelihood ratio is about evidence/(4 tau_c s^2). So evidence below evidence_time s^2 decides nothing: with 2 s and a
tau_c of 0.1 s that is a logarithm of 5.

A ramp is taken as shown below -(doubt + evidence_time s^2 + sum of S_u(0)/9). The last term is what a lag between two
of the tau may leave, which a ramp may then imitate: for slow commands F_tau u - u is about -tau du/dt, so S_u(tau) for
a true lag L is about (tau/L - 1)^2 S_u(0), at most a ninth of S_u(0) at the nearer of tau and 2 tau. A wrong
conclusion is final, since from then on the command is no faster than the ramp, and nothing distinguishes them. That the
robot follows is taken as shown above FOLLOWED doubt + evidence_time s^2: if that is wrong the command runs ahead of the
ramp, and the motion shows it. It remains shown until a ramp is: where friction changes its sign the command jumps so
that the velocity does not, and each such jump lowers the evidence a little, also without a ramp.

On a slow path r = u in each sample, and the evidence remains zero. The trial adds a square wave to the commands: after
a jump of 2 (a_max T/2 + trial) a ramp is 2 trial behind, and catches up within 2 trial/a_max. Then the sign changes, so
that r and u differ most of the time, and the pose moves little.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import casadi as ca

from dmframe.block import SX, Signals, State, clip, named, operation
from dmframe_blocks._identified_delay import Delayed, acting

DOUBT: Final = 1e-3
"""Default of `doubt` [rad^2/s]: an error of 0.03 rad/s over a second, for example by friction or an encoder."""

LAG: Final = 0.0125
"""Default of `lag_time` [s]."""
EVIDENCE_TIME: Final = 2.0
"""Default of `evidence_time` [s]."""
FOLLOWED: Final = 0.1
"""Share of `doubt` that suffices for the conclusion that the robot follows."""
GIVEN_UP: Final = 0.02
"""Evidence for a ramp, relative to `doubt`, that ends the trial."""
TRIED: Final = 0.125
"""Longest duration of the trial, relative to `evidence_time`."""
CAUGHT: Final = 1e-6
"""Difference from the command, relative to a_max T, below which a ramp has caught up."""
BEYOND: Final = 2
"""By how much corrections may exceed a_max after a trial, relative to a_max: enough for the friction at a reversal."""
RATIOS: Final = (1, 2, 4, 8, 16)
"""Time constants of the filters, relative to `lag_time`; that of a cascade without feed-forward is 1/k_p."""

STATES: Final = (
    State("path_before", "n", "rad/s", sampled=True, optional=True),
    State("ramped", "n", "rad/s", sampled=True, optional=True),
    State("gaps", "n d", "rad/s", sampled=True, optional=True, recorded=False),
    State("lagged", "n B", "rad/s", sampled=True, optional=True, recorded=False),
    State("lagged_ramp", "n B", "rad/s", sampled=True, optional=True, recorded=False),
    State("missed_u", "n S", "rad^2/s", sampled=True, optional=True, recorded=False),
    State("missed_r", "n S", "rad^2/s", sampled=True, optional=True, recorded=False),
    State("evidence", "", "rad^2/s", sampled=True, optional=True),
    State("follows", sampled=True, optional=True),
    State("wave", "n", "rad/s", sampled=True, optional=True),
)
"""Velocity along the path, the output r of the ramp, its differences r - u in the queue of commands, the states of the
filters with u and with r, S_u and S_r, the evidence, whether the robot follows, and the square wave of the trial."""

SIZES: Final = {"B": len(RATIOS), "S": len(RATIOS) + 1}
"""B: filters with a state; S: sums, the first one of tau = 0."""


class Limited(NamedTuple):
    """The change of the command within its limits, and the states, of which `begun` begin with the delay."""

    change: SX
    kept: Mapping[str, SX]
    begun: Mapping[str, SX]


def limited(block: Delayed, u: Signals, x: Signals, p: Signals, wished: SX, acted: SX) -> Limited:
    """The change towards the wished command; `acted` is the command that acted in the last completed sample.

    Unless a ramp is shown, or the delay is unknown, the path's own change is allowed also where it exceeds a_max. As
    much again is allowed for corrections, with a trial `BEYOND` times a_max, but only if it is shown that the robot
    follows: a loop whose corrections a ramp limits oscillates.
    """
    if "a_max" not in p:
        return Limited(wished - x.queue[:, -1], {}, {})
    room, known = p.a_max * u.T, 1 if block.delay_up_to is None else u.identified
    gap = acting(block, u, x.gaps)[:, 0]
    filters, sums, evidence, left, between = _compared(u, x, p, acted, acted + gap, known)
    unsure = named("unsure", p.evidence_time * left / ca.fmax(u.T * x.count, p.evidence_time))
    possible = named("possible", known * (x.count > 1) * (evidence + unsure + between + p.doubt >= 0))
    needed = named("needed", possible * (u.dq_path - x.path_before))
    likely = named("likely", unsure + FOLLOWED * p.doubt)
    begun = {"evidence": evidence, **sums}
    if "trial" in p:
        follows = named("follows_new", possible * ca.fmax(x.follows, evidence - likely > 0))
        held, more = x.queue[:, -1] - x.wave, follows * BEYOND * room
        low, high = ca.fmin(-room, needed) - more, ca.fmax(room, needed) + more
        steady = named("steady", ca.fmin(ca.fmax(wished - held, low), high))
        undecided = known * (1 - follows) * (evidence > -GIVEN_UP * p.doubt)
        wave = _tried(u, x, p, undecided, held + steady)
        begun |= {"follows": follows, "wave": wave}
        change = named("change", steady + wave - x.wave)
    else:
        more = (evidence - likely > 0) * ca.fmax(room / 2, ca.fabs(needed))
        low, high = ca.fmin(-room, needed - more), ca.fmax(room, needed + more)
        change = named("change", ca.fmin(ca.fmax(wished - x.queue[:, -1], low), high))
    sent = x.queue[:, -1] + change
    ramped = named("ramped_new", x.ramped + clip(sent - x.ramped, room))
    kept = {"path_before": u.dq_path, "ramped": ramped, **filters}
    return Limited(change, kept, {"gaps": ca.horzcat(x.gaps[:, 1:], ramped - sent), **begun})


def _tried(u: Signals, x: Signals, p: Signals, undecided: SX, steady: SX) -> SX:
    """The square wave; its sign changes when a ramp would have caught up. It is zero where the sum may exceed u_max."""
    room = p.a_max * u.T
    size = room / 2 + p.trial
    tries = undecided * (x.count > 1) * (u.T * x.count < TRIED * p.evidence_time)
    caught = ca.fabs(x.gaps[:, -1]) < CAUGHT * room
    wave = ca.if_else(caught, ca.if_else(x.wave > 0, -size, size), x.wave)
    return named("wave_new", tries * (ca.fabs(steady) + size <= p.u_max) * wave)


def _compared(
    u: Signals, x: Signals, p: Signals, acted: SX, ramped: SX, known: SX | int
) -> tuple[Mapping[str, SX], Mapping[str, SX], SX, SX, SX]:
    """The states of the filters, the sums, the evidence, the smaller sum and a ninth of S_u(0) after a sample.

    Filters begin at the joints' velocity.
    """
    v, filters, sums = named("v_sample", (u.q - x.q_before) / u.T), dict[str, SX](), dict[str, SX]()
    ratio = u.T / p.lag_time
    for state, total, sent in (("lagged", "missed_u", acted), ("lagged_ramp", "missed_r", ramped)):
        held = getattr(x, state)
        filters[state] = known * filtered(held, sent, ratio) + (1 - known) * ca.repmat(v, 1, len(RATIOS))
        sums[total] = named(f"{total}_new", getattr(x, total) + u.T * squared(averages(held, sent, ratio), v))
    by_ramp, by_lag = ca.sum1(least(sums["missed_r"])), ca.sum1(least(sums["missed_u"]))
    evidence = named("evidence_new", by_ramp - by_lag)
    between = named("between", ca.sum1(sums["missed_u"][:, 0]) / 9)
    return filters, sums, evidence, named("unexplained", ca.fmin(by_ramp, by_lag)), between


@operation
def filtered(held: Any, sent: Any, ratio: Any) -> Any:
    """The states of the filters of each joint after a sample of that command; ratio is T/lag_time."""
    return ca.horzcat(*(sent + (held[:, k] - sent) * ca.exp(-ratio / each) for k, each in enumerate(RATIOS)))


@operation
def averages(held: Any, sent: Any, ratio: Any) -> Any:
    """The average outputs of the filters over a sample; the first column is the command itself."""
    share = [(1 - ca.exp(-ratio / each)) * each / ratio for each in RATIOS]
    return ca.horzcat(sent, *(sent + (held[:, k] - sent) * each for k, each in enumerate(share)))


@operation
def squared(found: Any, v: Any) -> Any:
    """The square of each element's difference from the joint's velocity v."""
    return (found - ca.repmat(v, 1, found.shape[1])) ** 2


@operation
def least(sums: Any) -> Any:
    """The least element of each row."""
    found = sums[:, 0]
    for k in range(1, sums.shape[1]):
        found = ca.fmin(found, sums[:, k])
    return found
