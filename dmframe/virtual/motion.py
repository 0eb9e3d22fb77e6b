"""What a UR makes of speedj, servoj, movej and their kind: joint speeds, one for each cycle of its controller.

The makers publish none of these laws. Those here are plain ones, which the page of the virtual robot tells.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, final

import numpy as np

STOP: Final = 4.0
"""Of a motion that nobody ends [rad/s^2]."""
SMALL: Final = 1e-6
"""Of a cycle: times are rounded to whole ones."""


@dataclass
class Target:
    """Where the controller wants its joints: angles [rad], speeds [rad/s], accelerations [rad/s^2]."""

    q: np.ndarray
    qd: np.ndarray = field(default_factory=lambda: np.zeros(6))
    qdd: np.ndarray = field(default_factory=lambda: np.zeros(6))

    @property
    def still(self) -> bool:
        """True where no joint is to move."""
        return not self.qd.any()


class Motion(ABC):
    """One command that moves the robot, from when a script calls it until another takes its place.

    Attributes
    ----------
    done
        The script's call returns.
    """

    done = False

    @abstractmethod
    def speed(self, target: Target, dt: float, scale: float) -> np.ndarray:
        """Joint speeds for the coming cycle [rad/s]; `scale` is the speed slider's."""


def ramped(now: np.ndarray, wanted: np.ndarray, most: float) -> np.ndarray:
    """From one velocity towards another in a straight line, no component by more than `most`."""
    with np.errstate(invalid="ignore"):  # what is not a number is a protective stop, and no warning
        change = wanted - now
        largest = float(np.max(np.abs(change)))
        return wanted.copy() if largest <= most else now + change * (most / largest)


def cycles(time: float, dt: float) -> int:
    """A time in whole cycles, one at least."""
    return max(1, math.ceil(time / dt - SMALL))


@final
class Speed(Motion):
    """``speedj`` and, with a map from tool to joints, ``speedl``; after its time the joints slow down by themselves."""

    def __init__(
        self,
        wanted: np.ndarray,
        acceleration: float,
        time: float | None,
        to_joints: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
    ) -> None:
        self._wanted, self._acceleration, self._time, self._to_joints = wanted, acceleration, time, to_joints
        self._passed, self._tool = 0, np.zeros(6)

    def speed(self, target: Target, dt: float, scale: float) -> np.ndarray:
        """Towards what is wanted, by no more than a dt a cycle."""
        most = self._acceleration * dt
        if self._time is not None and self._passed >= cycles(self._time, dt):
            return ramped(target.qd, np.zeros(6), most)
        self._passed += 1
        wanted = scale * self._wanted
        if self._to_joints is None:
            found = ramped(target.qd, wanted, most)
            reached = bool(np.array_equal(found, wanted))
        else:
            self._tool = ramped(self._tool, wanted, most)
            found = self._to_joints(target.q, self._tool)
            reached = bool(np.array_equal(self._tool, wanted))
        self.done = self._passed >= cycles(self._time, dt) if self._time is not None else reached
        return found


@final
class Stop(Motion):
    """``stopj`` and what stands for ``stopl``: to rest, in a straight line of joint speeds."""

    def __init__(self, deceleration: float = STOP) -> None:
        self._deceleration = deceleration

    def speed(self, target: Target, dt: float, scale: float) -> np.ndarray:
        """Towards zero."""
        found = ramped(target.qd, np.zeros(6), self._deceleration * dt)
        self.done = not found.any()
        return found


@final
class Servo(Motion):
    """``servoj``: towards angles by a lag of the look-ahead time, for some time; then the robot stays there."""

    def __init__(self, q: np.ndarray, time: float, lookahead: float) -> None:
        self._q, self._time, self._lookahead, self._passed = q, time, lookahead, 0

    def speed(self, target: Target, dt: float, scale: float) -> np.ndarray:
        """The share of what is left that an exponential of that time covers in a cycle."""
        self._passed += 1
        self.done = self._passed >= cycles(self._time, dt)
        share = -math.expm1(-dt / self._lookahead) if self._lookahead > 0 else 1.0
        found: np.ndarray = scale * share * (self._q - target.q) / dt
        return found


@final
class Along(Motion):
    """``movej`` and ``movel``: from rest to rest along a path, its speed a trapezoid.

    Parameters
    ----------
    path
        s -> six angles at it, s from 0 to `length`.
    length
        In what `speed` and `acceleration` are given: radians of the joint that moves most, or metres.
    """

    def __init__(self, path: Callable[[float], np.ndarray], length: float, most: float, acceleration: float) -> None:
        self._path, self._length, self._most, self._acceleration = path, length, most, acceleration
        self._s, self._rate, self._begun = 0.0, 0.0, False

    def speed(self, target: Target, dt: float, scale: float) -> np.ndarray:
        """To where the path is one cycle later."""
        if not self._begun and not target.still:
            return ramped(target.qd, np.zeros(6), STOP * dt)
        self._begun = True
        left = self._length - self._s
        if left <= 0:
            self.done = True
            return np.zeros(6)
        braking = math.sqrt(2 * self._acceleration * left)
        rate = min(self._rate + self._acceleration * dt, self._most * scale, braking)
        # what a trapezoid cut into cycles leaves at its end is gone in one more
        ahead = left if left <= self._acceleration * dt * dt else min(rate * dt, left)
        self._rate, self._s = ahead / dt, self._s + ahead
        found: np.ndarray = (self._path(self._s) - target.q) / dt
        return found


def straight(start: np.ndarray, goal: np.ndarray) -> tuple[Callable[[float], np.ndarray], float]:
    """The straight line between angles, by radians of the joint that moves most; and its length."""
    way = goal - start
    length = float(np.max(np.abs(way)))

    def at(s: float) -> np.ndarray:
        return goal.copy() if s >= length else start + way * (s / length)

    return at, length
