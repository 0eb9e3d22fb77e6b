"""Motion commands of a UR (speedj, servoj, movej, ...): target joint speeds for each cycle of the controller.

The makers do not publish their laws. Those here are simple ones; docs/how_to/virtual_robot.md describes them.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, final

import numpy as np

STOP: Final = 4.0
"""Deceleration after a motion that was not ended by a command [rad/s^2]."""
SMALL: Final = 1e-6
"""Tolerance for rounding times to whole cycles [cycles]."""


@dataclass
class Target:
    """Joint targets: angles [rad], speeds [rad/s], accelerations [rad/s^2]."""

    q: np.ndarray
    qd: np.ndarray = field(default_factory=lambda: np.zeros(6))
    qdd: np.ndarray = field(default_factory=lambda: np.zeros(6))

    @property
    def still(self) -> bool:
        """True if all target speeds are zero."""
        return not self.qd.any()


class Motion(ABC):
    """One motion command, active until another replaces it.

    Attributes
    ----------
    done
        True when the script's call returns.
    """

    done = False

    @abstractmethod
    def speed(self, target: Target, dt: float, scale: float) -> np.ndarray:
        """Joint speeds of the next cycle [rad/s]; `scale` is the speed slider's value."""


def ramped(now: np.ndarray, wanted: np.ndarray, most: float) -> np.ndarray:
    """Move from one velocity towards another along a straight line, each component by at most `most`."""
    with np.errstate(invalid="ignore"):  # NaN leads to a protective stop
        change = wanted - now
        largest = float(np.max(np.abs(change)))
        return wanted.copy() if largest <= most else now + change * (most / largest)


def cycles(time: float, dt: float) -> int:
    """Number of cycles of a time, at least one."""
    return max(1, math.ceil(time / dt - SMALL))


@final
class Speed(Motion):
    """``speedj`` and, with a map from tool to joint velocities, ``speedl``; decelerates after its time."""

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
        """Accelerate towards the commanded speed, by at most a dt in a cycle."""
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
    """``stopj``, and ``stopl`` in joint space: decelerates to rest along a straight line of joint speeds."""

    def __init__(self, deceleration: float = STOP) -> None:
        self._deceleration = deceleration

    def speed(self, target: Target, dt: float, scale: float) -> np.ndarray:
        """Decelerate towards zero."""
        found = ramped(target.qd, np.zeros(6), self._deceleration * dt)
        self.done = not found.any()
        return found


@final
class Servo(Motion):
    """``servoj``: first-order lag towards angles with the look-ahead time as time constant, for some time."""

    def __init__(self, q: np.ndarray, time: float, lookahead: float) -> None:
        self._q, self._time, self._lookahead, self._passed = q, time, lookahead, 0

    def speed(self, target: Target, dt: float, scale: float) -> np.ndarray:
        """Cover the fraction of the remaining distance that the exponential covers in a cycle."""
        self._passed += 1
        self.done = self._passed >= cycles(self._time, dt)
        fraction = -math.expm1(-dt / self._lookahead) if self._lookahead > 0 else 1.0
        found: np.ndarray = scale * fraction * (self._q - target.q) / dt
        return found


@final
class PathMotion(Motion):
    """``movej`` and ``movel``: along a path from rest to rest, with a trapezoidal speed profile.

    Parameters
    ----------
    path
        Six joint angles as a function of s, from 0 to `length`.
    length
        Length of the path, in the unit of `most` and `acceleration`: radians of the joint that moves most, or metres.
    """

    def __init__(self, path: Callable[[float], np.ndarray], length: float, most: float, acceleration: float) -> None:
        self._path, self._length, self._most, self._acceleration = path, length, most, acceleration
        self._s, self._rate, self._started = 0.0, 0.0, False

    def speed(self, target: Target, dt: float, scale: float) -> np.ndarray:
        """Move to the point of the path one cycle later."""
        if not self._started and not target.still:
            return ramped(target.qd, np.zeros(6), STOP * dt)
        self._started = True
        left = self._length - self._s
        if left <= 0:
            self.done = True
            return np.zeros(6)
        braking = math.sqrt(2 * self._acceleration * left)
        rate = min(self._rate + self._acceleration * dt, self._most * scale, braking)
        # the remainder that discretization leaves at the end of the trapezoid is covered in one more cycle
        ahead = left if left <= self._acceleration * dt * dt else min(rate * dt, left)
        self._rate, self._s = ahead / dt, self._s + ahead
        found: np.ndarray = (self._path(self._s) - target.q) / dt
        return found


def straight(start: np.ndarray, goal: np.ndarray) -> tuple[Callable[[float], np.ndarray], float]:
    """Straight line between joint angles, parametrized by radians of the joint that moves most, and its length."""
    displacement = goal - start
    length = float(np.max(np.abs(displacement)))

    def at(s: float) -> np.ndarray:
        return goal.copy() if s >= length else start + displacement * (s / length)

    return at, length
