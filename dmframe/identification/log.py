"""A log of commands and positions, as the estimator reads it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

Array = np.ndarray


@final
@dataclass(frozen=True)
class Unknown:
    """An unknown part of the commands of a joint: a number [rad/s], times `gains`, is added to the commands `rows`.

    Parameters
    ----------
    deviation
        Standard deviation of the number before the log is seen; its mean is zero.
    """

    joint: int
    rows: tuple[int, ...]
    gains: tuple[float, ...]
    deviation: float


@final
@dataclass(frozen=True, eq=False)
class Log:
    """Recorded samples.

    Parameters
    ----------
    time
        (N,), instants [s].
    q
        (N, n), positions [rad].
    u
        (K, n), velocity commands, each constant until the next [rad/s].
    ahead
        (n,), q_c - q at the first sample [rad].
    sent
        (K,), instants of the commands [s]; by default those of the samples but the last, K = N - 1.
    unknown
        Parts of the commands that were not recorded.
    by_sample
        Whether the delay is a number of intervals between commands, which vary, instead of a time.
    hidden
        (N,), True for samples that are not compared; by default none.
    """

    time: Array
    q: Array
    u: Array
    ahead: Array
    sent: Array | None = None
    unknown: tuple[Unknown, ...] = ()
    by_sample: bool = False
    hidden: Array | None = None

    @cached_property
    def instants(self) -> Array:
        """Instants of the commands, and of the last sample (K + 1,) [s]."""
        return (
            np.append(self.time[:-1], self.time[-1])
            if self.sent is None
            else np.append(self.sent, max(self.time[-1], self.sent[-1]))
        )

    @cached_property
    def period(self) -> float:
        """Sampling period, the median interval [s]."""
        return float(np.median(np.diff(self.time)))

    @cached_property
    def noise(self) -> float:
        """Standard deviation of the positions' white noise, from their sixth divided differences [rad].

        With equal intervals, those of a motion without frequencies above a tenth of the Nyquist frequency are below
        1e-3 of it.
        """
        count = len(self.time) - 6
        nodes = np.array([self.time[k : k + count] for k in range(7)]) / self.period
        apart = nodes[:, None] - nodes[None] + np.eye(7)[:, :, None]
        weights = 1 / np.prod(apart, axis=1)
        weights /= np.sqrt(np.sum(weights**2, axis=0))
        each = sum(weights[k][:, None] * self.q[k : k + count] for k in range(7))
        return float(np.max(1.4826 * np.median(np.abs(each), axis=0)))

    @property
    def moving(self) -> bool:
        """True if the robot may move at the first sample."""
        return bool(np.any(np.abs(self.u[:3]) > 1e-6))

    def commanded(self, at: Array) -> Array:
        """Commanded positions relative to q at the first sample, at some instants: (len(at), n) [rad]."""
        moved = np.cumsum(self.u * np.diff(self.instants)[:, None], axis=0)
        held = self.ahead + np.vstack([0 * self.u[:1], moved])
        return np.column_stack([np.interp(at, self.instants, column) for column in held.T])

    def acting(self, delay: float) -> tuple[Array, Array]:
        """When the commands act if they are `delay` late [s], and the derivatives of these instants by the delay."""
        sent = self.instants[:-1]
        if not self.by_sample:
            return sent + delay, np.ones(len(sent))
        place = np.arange(len(sent)) + delay / self.period
        later = np.append(self.instants, self.instants[-1] + self.period * np.arange(1, 10))
        slopes = np.diff(later) / self.period
        return np.interp(place, np.arange(len(later)), later), slopes[np.minimum(place.astype(int), len(slopes) - 1)]
