"""Interface of robot drivers: they read samples and send joint velocity commands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, final

import numpy as np


@final
@dataclass(frozen=True, eq=False)
class Sample:
    """Measurements of a robot at one instant.

    Parameters
    ----------
    time
        Time of the robot's clock [s].
    q, dq
        (n,) measured joint angles [rad] and velocities [rad/s].
    q_c
        (n,) target angles of the servo [rad]; None if not available.
    x
        Tool position in the graph's frame [m]; None if not available.
    scaling
        Factor by which the robot scales commanded speeds, as a speed slider does; 1 for none.
    ready
        False if the robot does not accept commands.
    fault
        Fault of the robot's controller; empty for none.
    age
        Age of the last command that the robot received [s]; None if not available.
    missed
        Number of samples lost before this one.
    """

    time: float
    q: np.ndarray
    dq: np.ndarray
    q_c: np.ndarray | None = None
    x: np.ndarray | None = None
    scaling: float = 1.0
    ready: bool = True
    fault: str = ""
    age: float | None = None
    missed: int = 0


class Robot(Protocol):
    """Driver of a robot. All methods may raise `dmframe.common.errors.LostError`."""

    @property
    def name(self) -> str:
        """Name in messages: ``sim`` or ``ur:192.168.0.2``."""

    @property
    def period(self) -> float:
        """Sampling period [s]."""

    def connect(self) -> None:
        """Connect. Raises `LostError` if the robot does not answer."""

    def read(self) -> Sample:
        """Wait for the robot's next sample."""

    def begin(self) -> None:
        """Start to accept commands; called once, when the robot is at its start pose."""

    def command(self, dq: np.ndarray) -> None:
        """Move with these velocities [rad/s] for one period."""

    def move(self, q: np.ndarray, speed: float, acceleration: float, watched: Callable[[Sample], bool]) -> None:
        """Move to a pose [rad] and stop there, no joint above the speed [rad/s].

        Call `watched` with each sample, and return as soon as it is True; a call of `stop` follows then.
        """

    def stop(self, deceleration: float) -> None:
        """Decelerate to rest [rad/s^2]. It is also called after faults, and may be called twice."""

    def close(self) -> None:
        """Disconnect."""
