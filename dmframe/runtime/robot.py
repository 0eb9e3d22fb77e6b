"""What a driver of a robot does: it tells samples, and takes velocities of joints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, final

import numpy as np


@final
@dataclass(frozen=True, eq=False)
class Sample:
    """What a robot shows at one instant.

    Parameters
    ----------
    time
        By the robot's own clock [s].
    q, dq
        (n,) joint angles [rad] and velocities [rad/s], measured.
    q_c
        (n,) the target angles of its servo [rad]; None where the robot does not tell them.
    x
        Where its tool is, in the graph's own frame [m]; None where the robot does not tell it.
    scaling
        By how much the robot slows down what it is commanded, as a speed slider does: 1 for not at all.
    ready
        False for one that takes no commands now.
    fault
        What its maker's controller says is wrong; empty for nothing.
    age
        How long ago the command was sent that the robot had taken last [s]; None where it does not tell.
    missed
        Samples of the robot that were lost since the one before this.
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
    """A driver. All but `connect` may raise `dmframe.errors.LostError`."""

    @property
    def name(self) -> str:
        """As messages call it, ``sim`` or ``ur:192.168.0.2``."""

    @property
    def period(self) -> float:
        """From one sample to the next [s]."""

    def connect(self) -> None:
        """Make ready to read. Raises `LostError` where nobody answers."""

    def read(self) -> Sample:
        """Wait for the robot's next sample."""

    def begin(self) -> None:
        """Take commands from now on; called once, where the robot stands at its start."""

    def command(self, dq: np.ndarray) -> None:
        """Move with these velocities [rad/s] for one period."""

    def move(self, q: np.ndarray, speed: float, acceleration: float, watched: Callable[[Sample], bool]) -> None:
        """Go to a pose [rad] and come to rest there, no joint above the speed [rad/s].

        What the robot shows on its way is handed to `watched`; at its first True return at once: `stop` comes next.
        """

    def stop(self, deceleration: float) -> None:
        """Come to rest [rad/s^2]. It is called after faults, too, and may be called twice."""

    def close(self) -> None:
        """Let go of the robot."""
