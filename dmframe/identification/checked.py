"""Checks of a log: clock, finite numbers, units, order of columns, excitation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final, final

import numpy as np

from dmframe.common.errors import ValueFault
from dmframe.identification.clipped import Limit, clipped, cut, fitted
from dmframe.identification.clock import alternatives, clock_of, regular, with_losses
from dmframe.identification.log import Array, Log
from dmframe.robot.chain import SerialChain

FEWEST: Final = 200
MOST: Final = 20_000
"""Samples that are used; of a longer log those with the most changes of the commands."""
PERIODS: Final = (2e-4, 0.2)
"""Range of sampling periods [s]."""
GAP: Final = 3.5
"""Longest interval between samples, in periods."""
Refuse = Callable[[str], ValueFault]
SHORTEST: Final = 5.5
"""Shortest log [s]: a log of 3 s gave a k_P with an error of 5 %, outside its interval."""
CHANGES: Final = 8
"""Least number of quick changes of a joint's velocity command."""
QUICK: Final = 0.1
"""Duration of a quick change [s]."""
SIZE: Final = 0.15
"""Least size of a change, and of a velocity in each direction, relative to the range of the joint's commands."""
REMEDY: Final = "record the steps that dmframe experiment ROBOT writes: 20 s, every joint, both directions"


@final
@dataclass(frozen=True, eq=False)
class Checked:
    """A log that can be used.

    Parameters
    ----------
    others
        Other readings of irregular times, with what they assume.
    limits
        Velocities to which the robot clips the commands.
    again
        The same with other limits.
    """

    log: Log
    notices: tuple[str, ...]
    others: tuple[tuple[Log, str], ...]
    limits: tuple[Limit, ...]
    again: Callable[[tuple[Limit, ...]], Checked]


def checked_log(signals: dict[str, Array], chain: SerialChain, where: str) -> Checked:
    """The log of some signals.

    Raises
    ------
    ValueFault
        The log cannot be right, or excites too little; the text has the place and the remedy.
    """

    def refuse(text: str) -> ValueFault:
        return ValueFault(text, location=where)

    for name, values in signals.items():
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            joint = f"_{bad[0][1] + 1}" if values.ndim == 2 else ""
            raise refuse(
                f"{name}{joint}: expected finite numbers, found {len(bad)} others, the first in row {bad[0][0] + 2}; "
                "remove or repair these rows"
            )
    t, q = signals["t"], signals["q"]
    if len(t) < FEWEST:
        raise refuse(f"expected at least {FEWEST} samples, found {len(t)}; record about 20 s")
    _clock(t, refuse)
    notices = list[str]()
    dq_c, q_c = signals.get("dq_c"), signals.get("q_c")
    mean = dq_c is None
    if dq_c is None:
        assert q_c is not None  # `signals_of` requires one of them
        u = np.diff(q_c, axis=0) / np.diff(t)[:, None]
        notices.append("velocity commands are differences of q_c")
    else:
        u = dq_c[:-1]
    _units(t, q, u, chain, refuse)
    _excited(t, q, u, refuse)
    limits = clipped(t, q, u) if q_c is None else ()
    _matched(t, q, cut(u, limits), refuse)
    if q_c is not None and dq_c is not None:
        u, mean, text = _consistent(t, dq_c, q_c, refuse)
        notices.append(text)
    ahead = np.zeros(chain.n) if q_c is None else q_c[0] - q[0]
    if np.max(np.abs(ahead)) > 0.1:
        raise refuse(f"q_c - q is {np.max(np.abs(ahead)):.2g} rad at the first sample; begin the log at rest")
    if len(t) > MOST:
        energy = np.concatenate([[0], np.cumsum(np.sum(np.abs(np.diff(u, axis=0)), axis=1)), [0]])[: len(t)]
        first = int(np.argmax(energy[MOST - 1 : -1] - energy[:-MOST]))
        still = np.flatnonzero(np.all(np.abs(u) < 1e-6, axis=1))
        before = still[still <= first]
        first = int(before[-1]) if len(before) else first
        rows = slice(first, min(first + MOST, len(t)))
        notices.append(f"used: {MOST} of {len(t)} samples, those with the most changes of the commands")
        t, q, u, ahead = t[rows], q[rows], u[rows][:-1], np.zeros(chain.n)
        u = u[: len(t) - 1]
    return _built(t - t[0], q, np.ascontiguousarray(u), ahead, limits, mean, tuple(notices), refuse)


def _built(
    t: Array,
    q: Array,
    u: Array,
    ahead: Array,
    limits: tuple[Limit, ...],
    mean: bool,
    notices: tuple[str, ...],
    refuse: Refuse,
) -> Checked:
    """The log with clipped commands and lost samples."""
    clock, own = clock_of(t), cut(u, limits)
    record, read = regular(Log(t, q, own, ahead, unknown=tuple(limit.unknown(own) for limit in limits)), clock)
    try:
        record, losses = with_losses(record, clock, mean)
    except ValueFault as fault:
        raise refuse(str(fault)) from None
    again = partial(_built, t, q, u, ahead, mean=mean, notices=notices, refuse=refuse)
    texts = (*notices, *map(str, limits), *read, *losses)
    return Checked(record, texts, tuple(alternatives(record, clock)), limits, again)


def _clock(t: Array, refuse: Refuse) -> None:
    steps = np.diff(t)
    period = float(np.median(steps))
    if np.any(steps <= 0):
        row = int(np.argmax(steps <= 0)) + 3
        raise refuse(f"time does not increase in row {row}: sort the rows and remove repeated ones")
    if not PERIODS[0] <= period <= PERIODS[1]:
        hint = "time seems to be in ms; divide it by 1000" if 0.2 < period < 200 else "time is needed in s"
        raise refuse(f"time: expected a period of {PERIODS[0]:g} to {PERIODS[1]:g} s, found {period:.4g}; {hint}")
    if np.max(steps) > GAP * period:
        row = int(np.argmax(steps)) + 3
        raise refuse(
            f"gap of {np.max(steps):.3g} s before row {row}, {np.max(steps) / period:.0f} periods; use "
            "a part of the log without gaps"
        )


SAME_UNIT: Final = 0.3
"""Relative deviation of a ratio of positions and commands from that of two units."""


def _units(t: Array, q: Array, u: Array, chain: SerialChain, refuse: Refuse) -> None:
    """Compare speeds and ranges with the limits of the robot's file."""
    speed = np.max(np.abs(u), axis=0)
    for j, joint in enumerate(chain.joints):
        limit = joint.velocity if 0 < joint.velocity < np.inf else 10.0
        span = 7.0 if joint.kind == "revolute" else 20.0
        far = float(np.max(np.abs(q[:, j])))
        beyond = [name for name, bad in (("positions", far > span), ("commands", speed[j] > 2 * limit)) if bad]
        if beyond:
            moved, commanded = np.ptp(q[:, j]), np.ptp(np.cumsum(u[: len(t) - 1, j] * np.diff(t)[: len(u)]))
            largest = max(far / span, speed[j] / (2 * limit))
            unit = _unit(joint.kind, float(moved / commanded) if moved and commanded else 1.0, float(largest))
            raise refuse(
                f"joint {j + 1}: positions reach {far:.3g} and commands {speed[j]:.3g} per s: "
                f"{' and '.join(beyond)} are beyond the robot's limits, and seem to be in {unit}"
            )


def _unit(kind: str, ratio: float, largest: float) -> str:
    """The unit that one or both of positions and commands probably have, with the divisor.

    `ratio` is how many times as far as commanded the positions move: a unit that only one of them has. Of both the
    unit is the first in which the `largest` value, relative to its limit, is allowed.
    """
    units = [("degrees", 57.29578), ("mrad", 1000.0)] if kind == "revolute" else [("mm", 1000.0)]
    by_ratio = [unit for unit in units if any(abs(each / unit[1] - 1) < SAME_UNIT for each in (ratio, 1 / ratio))]
    allowed = [unit for unit in units if largest <= unit[1]]
    name, factor = [*by_ratio, *allowed, units[-1]][0]
    return f"{name}; divide by {factor:.7g}"


def _excited(t: Array, q: Array, u: Array, refuse: Refuse) -> None:
    """Refuse a log that is too short, or a joint that hardly moves, in one direction, or without quick changes."""
    lasting = float(t[-1] - t[0])
    if lasting < SHORTEST:
        raise refuse(
            f"the log lasts {lasting:.3g} s, and excites the joints too little: expected {SHORTEST:g} s; {REMEDY}"
        )
    for j in range(q.shape[1]):
        what, span = "", float(np.ptp(u[:, j]))
        count = _changes(u[:, j], max(1, round(QUICK / float(np.median(np.diff(t))))), SIZE * span)
        if np.ptp(q[:, j]) < 0.01 or span < 0.02:
            what = f"{np.ptp(q[:, j]):.2g} rad, velocity commands within {span:.2g} rad/s"
        elif max(u[:, j]) < SIZE * span or min(u[:, j]) > -SIZE * span:
            what = "it moves in one direction only"
        elif count < CHANGES:
            what = (
                f"its velocity command changes quickly {count} times, expected {CHANGES}: slow or few changes do not "
                "separate delay, gains and friction"
            )
        if what:
            raise refuse(f"joint {j + 1}: the log excites it too little ({what}); {REMEDY}")


def _changes(u: Array, window: int, size: float) -> int:
    """Number of changes by `size` within `window` samples, without overlap."""
    places, count, after = np.flatnonzero(np.abs(u[window:] - u[:-window]) >= size), 0, -1
    for k in places:
        if k > after:
            count, after = count + 1, int(k) + window
    return count


def _matched(t: Array, q: Array, u: Array, refuse: Refuse) -> None:
    """Compare each joint's position with the integral of each command, at the lag at which they agree best."""
    held = np.vstack([0 * u[:1], np.cumsum(u * np.diff(t)[:, None], axis=0)])
    n = q.shape[1]
    for j in range(n):
        own = q[:, j] - q[0, j]
        fits = [fitted(held[:, k], own) for k in range(n)]
        share, factor, lag = fits[j]
        better = int(np.argmin([fit[0] for fit in fits]))
        if share > 0.3 and better != j and fits[better][0] < 0.5 * share:
            raise refuse(f"position {j + 1} follows command {better + 1}: columns seem to be swapped; use --columns")
        if lag < 0:
            raise refuse(
                f"joint {j + 1}: positions lead their commands by {-lag} samples: q and q_c, or actual and "
                "target, seem to be swapped"
            )
        if np.ptp(held[:, j]) > 0.01 and not 0.5 < factor < 2:
            raise refuse(f"joint {j + 1}: positions move {factor:.3g} times as far as commanded; {_mixed(factor)}")
        if np.ptp(held[:, j]) > 0.01 and share > 0.5:
            raise refuse(
                f"joint {j + 1}: positions do not follow the commands ({100 * share:.0f} % unexplained); "
                "check columns, units and signs"
            )


def _mixed(factor: float) -> str:
    """What a factor between the motion and its command suggests."""
    for size, one, other in ((180 / np.pi, "degrees", "rad"), (1000.0, "mm", "m")):
        for larger, smaller, ratio in (("positions", "commands", factor), ("commands", "positions", 1 / factor)):
            if 0.8 * size < ratio < 1.25 * size:
                return f"{larger} seem to be in {one}, and {smaller} in {other}"
    return f"{'units, or ms and s,' if factor > 0 else 'signs or columns'} seem to be mixed"


def _consistent(t: Array, dq_c: Array, q_c: Array, refuse: Refuse) -> tuple[Array, bool, str]:
    """Commands that agree with both columns: differences of q_c (True) where they are those of dq_c, else dq_c."""
    slopes = np.diff(q_c, axis=0) / np.diff(t)[:, None]
    between = 0.5 * (dq_c[1:] + dq_c[:-1])
    size = max(float(np.std(slopes)), 1e-9)
    if np.std(slopes - between) < 0.02 * size and np.std(slopes - between) < np.std(slopes - dq_c[:-1]):
        return slopes, True, "velocity commands are differences of q_c, which agree with dq_c"
    for lag in range(-1, 8):
        late, early = (
            (slopes[lag:], dq_c[: len(slopes) - lag]) if lag >= 0 else (slopes[:lag], dq_c[-lag : len(slopes)])
        )
        if np.std(late - early) < 0.2 * size:
            return dq_c[:-1], False, f"commands are dq_c; q_c follows them by {lag} samples"
    raise refuse("dq_c is not the rate of q_c at any lag up to 7 samples: check columns and units")
