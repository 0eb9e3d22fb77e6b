"""Velocity steps of every joint that stay in a box of joint positions, begin and end at rest, and end at the start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, final

import numpy as np

from dmframe.identification.log import Array

REST: Final = (0.5, 0.7)
"""Time at rest at the beginning and at the end [s]."""
DWELL: Final = (0.15, 1.0)
"""Length of a step [s]: the shortest determine delay and gains, the longest friction and integral gains."""
PAUSE: Final = (0.1, 0.5)
"""Length of a rest between steps [s]."""
PAUSED: Final = 0.2
"""Fraction of steps after which the joint rests."""
TURNED: Final = 0.6
"""Fraction of steps that the opposite direction follows at least."""
SLOWEST: Final = 0.15
"""Slowest step, as a fraction of a joint's fastest: friction needs several speeds."""
LONGEST_RAMP: Final = 0.3
"""Longest duration of a change [s]; with a lower acceleration the joint is slower."""


@final
@dataclass(frozen=True, eq=False)
class Room:
    """Where and how fast joints may move.

    Parameters
    ----------
    start, lower, upper
        (n,), start posture and the box around it [rad, m].
    speed, acceleration
        (n,), largest [rad/s, m/s] and [rad/s^2, m/s^2]; infinite accelerations are steps.
    """

    start: Array
    lower: Array
    upper: Array
    speed: Array
    acceleration: Array


@final
@dataclass(frozen=True, eq=False)
class Excitation:
    """Velocity commands.

    Parameters
    ----------
    period
        Sampling period [s].
    count
        Number of samples.
    start
        (n,), positions at the first sample [rad, m].
    at, speeds
        (K,) samples, and (K, n) velocities from each of them on [rad/s, m/s].
    ramp
        (n,), samples that a change takes; 0 for steps.
    """

    period: float
    count: int
    start: Array
    at: Array
    speeds: Array
    ramp: Array

    @property
    def time(self) -> Array:
        """Instants (count,) [s]."""
        return self.period * np.arange(self.count)

    @cached_property
    def dq_c(self) -> Array:
        """Commands (count, n), each constant until the next sample; as the block `velocity_steps` computes them."""
        found = np.zeros((self.count, len(self.start)))
        samples = np.arange(self.count)
        changes = np.diff(self.speeds, axis=0, prepend=0)
        for first, change in zip(self.at, changes, strict=True):
            late = (samples[first:] - first)[:, None]
            found[first:] += change * np.where(self.ramp > 0, np.minimum(late / np.maximum(self.ramp, 1), 1), 1)
        return found

    @cached_property
    def q_c(self) -> Array:
        """Positions (count, n) to which the commands lead [rad, m]."""
        moved = np.cumsum(self.period * self.dq_c[:-1], axis=0)
        return np.asarray(self.start + np.vstack([0 * self.start, moved]))


def excitation(room: Room, period: float, seconds: float, seed: Sequence[int] | int) -> Excitation:
    """Random steps of every joint; their lengths differ between joints, so that no two joints move in step."""
    random, count = np.random.default_rng(seed), round(seconds / period)
    fastest = np.minimum(room.speed, (room.upper - room.lower) / (2 * DWELL[0]))
    fastest = np.minimum(fastest, LONGEST_RAMP * room.acceleration / 2)
    ramp = np.ceil(2 * fastest / room.acceleration / period - 1e-9).astype(int)
    changes = [_joint(room, j, float(fastest[j]), int(ramp[j]), period, count, random) for j in range(len(room.start))]
    at = np.unique(np.concatenate([np.fromiter(own, int) for own in changes]))
    speeds = np.zeros((len(at), len(changes)))
    for j, own in enumerate(changes):
        for first, value in sorted(own.items()):
            speeds[at >= first, j] = value
    return Excitation(period, count, room.start, at, speeds, ramp)


def _joint(
    room: Room, j: int, fastest: float, ramp: int, period: float, count: int, random: np.random.Generator
) -> dict[int, float]:
    """Sample of each change of a joint's velocity, and the velocity after it.

    Positions are computed without ramps, with which they are moving averages of these, and stay in the same box.
    """
    lower, upper = room.lower[j] - room.start[j], room.upper[j] - room.start[j]
    shortest, last = max(2, ramp + round(DWELL[0] / period)), count - 1 - round(REST[1] / period) - ramp
    k, x, before, found = round(REST[0] * random.uniform(1, 1.6) / period), 0.0, 0, dict[int, float]()
    while True:
        sign = -before if before and random.random() < TURNED else int(random.choice([-1, 1]))
        speed = fastest * SLOWEST ** random.random()
        left = {1: upper - x, -1: x - lower}
        if left[sign] < speed * period * shortest:
            sign = -sign
        length = round(random.uniform(*DWELL) / period)
        length = max(shortest, min(length, int(left[sign] / (speed * period))))
        speed = min(speed, left[sign] / (length * period))
        there = x + sign * speed * length * period
        if k + length + shortest + abs(there) / (fastest * period) > last:
            break
        found[k], x, k, before = sign * speed, there, k + length, sign
        pause = ramp + round(random.uniform(*PAUSE) / period)
        if random.random() < PAUSED and k + pause + shortest + abs(x) / (fastest * period) < last:
            found[k], k, before = 0.0, k + pause, 0
    length = max(shortest, int(np.ceil(abs(x) / (fastest * period))))
    found[k], found[k + length] = -x / (length * period), 0.0
    return found
