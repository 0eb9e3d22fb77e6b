"""Clock of a log: lost samples, whose commands become unknowns, and intervals that vary."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from dmframe.common.errors import ValueFault
from dmframe.identification.log import Array, Log, Unknown
from dmframe.identification.model import SLOTS

VARIES: Final = 0.1
"""Deviation of the intervals from multiples of the period above which long intervals count as such, not as losses."""
STEADY: Final = 1e-3
"""Deviation of an instant from a regular grid, relative to the period, that does not count."""
BETTER: Final = 0.7
"""Noise of the positions at other instants, relative to that at the recorded ones, with which those are wrong."""
SETTLING: Final = 6
"""Samples after a loss that are not compared if only the mean of the lost commands is known."""


@final
@dataclass(frozen=True, eq=False)
class Clock:
    """Intervals of a log.

    Parameters
    ----------
    index
        (N,), number of each sample, with those that were lost.
    grid
        (N,), instants of a regular clock with these numbers [s].
    period
        Of that clock [s].
    spread
        Standard deviation of the intervals from whole multiples of the period, relative to it.
    """

    index: Array
    grid: Array
    period: float
    spread: float

    @property
    def gaps(self) -> Array:
        """Samples before a loss."""
        return np.flatnonzero(np.diff(self.index) > 1)


def clock_of(time: Array) -> Clock:
    """The clock of increasing instants."""
    steps = np.diff(time)
    ratio = steps / np.median(steps)
    spread = 1.4826 * float(np.median(np.abs(ratio - np.maximum(np.round(ratio), 1))))
    counts = np.maximum(np.round(ratio), 1) if spread < VARIES else np.ones(len(steps))
    index = np.concatenate([[0], np.cumsum(counts)])
    period, first = np.polyfit(index, time, 1)
    return Clock(index.astype(int), first + period * index, float(period), spread)


def with_losses(log: Log, clock: Clock, mean: bool) -> tuple[Log, tuple[str, ...]]:
    """The log with commands for lost samples, and notices.

    A lost command is unknown if it lies at a change. With `mean`, the commands are differences of positions, whose mean
    over a loss is known: samples after a loss at a change are then not compared.

    Raises
    ------
    ValueFault
        More commands were lost at changes than can be reconstructed.
    """
    if not len(clock.gaps):
        return log, ()
    lost, enough = int(np.sum(np.diff(clock.index)) - len(log.u)), 0.25 * log.noise
    share = f"{lost} of {clock.index[-1] + 1} samples are lost ({100 * lost / (clock.index[-1] + 1):.2g} %)"
    if mean:
        hidden = np.zeros(len(log.time), bool)
        for k in clock.gaps:
            jumps = np.abs(np.diff(log.u[max(k - 1, 0) : k + 2], axis=0))
            if np.max(jumps, initial=0.0) * clock.period / 4 > enough:
                hidden[k + 1 : k + 1 + SETTLING] = True
        text = f"; {int(np.sum(hidden))} samples after a loss at a change of the commands are not compared"
        return replace(log, hidden=hidden), (share + text,)
    sent, rows, unknown = list[float](), list[Array](), list[Unknown]()
    for k in range(len(log.u)):
        sent.append(log.time[k])
        rows.append(log.u[k])
        missing = int(clock.index[k + 1] - clock.index[k]) - 1
        after = log.u[min(k + 1, len(log.u) - 1)]
        for i in range(1, missing + 1):
            part = i / (missing + 1)
            for joint in np.flatnonzero(np.abs(after - log.u[k]) * clock.period / 4 > enough):
                unknown.append(Unknown(int(joint), (len(rows),), (1.0,), float(np.abs(after - log.u[k])[joint])))
            sent.append((1 - part) * log.time[k] + part * log.time[k + 1])
            rows.append((1 - part) * log.u[k] + part * after)
    if len(log.unknown) + len(unknown) > SLOTS:
        raise ValueFault(
            f"{share}, {len(unknown)} of their commands at changes, which are not known: expected at most {SLOTS}. "
            "Record the commanded positions q_c too, or repeat the record without losses"
        )
    kept = [replace(part, rows=tuple(np.searchsorted(sent, log.time[list(part.rows)]))) for part in log.unknown]
    text = f"; {len(unknown)} of their commands lie at changes and are estimated" if unknown else ""
    return replace(log, u=np.array(rows), sent=np.array(sent), unknown=(*kept, *unknown)), (share + text,)


def regular(log: Log, clock: Clock) -> tuple[Log, tuple[str, ...]]:
    """The log on a regular clock if its positions are smoother there: then the recorded times vary, not the samples."""
    apart = clock.grid - clock.grid[0] - log.time
    apart -= np.mean(apart)
    size = float(np.max(np.abs(apart)))
    if size < STEADY * clock.period or size > clock.period / 2:
        return log, ()
    other = replace(log, time=clock.grid - clock.grid[0])
    if other.noise > BETTER * log.noise:
        return log, (
            f"the intervals vary by {100 * clock.spread:.2g} %: positions are simulated at the recorded times",
        )
    text = (
        f"the recorded times deviate from a regular clock by up to {size:.2g} s, the samples do not: its times are used"
    )
    return other, (text,)


def alternatives(log: Log, clock: Clock) -> Iterator[tuple[Log, str]]:
    """Other readings of a log whose intervals vary, for when its commands act."""
    apart = clock.grid - log.time
    if np.max(np.abs(apart - np.mean(apart))) < STEADY * clock.period:
        return
    yield replace(log, by_sample=True), "the delay is a number of intervals between commands, not a time"
    if np.max(np.abs(apart)) < clock.period / 2:
        sent = clock.grid[:-1] if log.sent is None else clock.grid[0] + clock.period * np.arange(len(log.u))
        yield replace(log, sent=sent), "commands are sent on a regular clock"
