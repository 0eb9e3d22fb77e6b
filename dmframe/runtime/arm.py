"""Joints of an arm: free joints of the graph and held joints; common to all hardware drivers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from dmframe.common.errors import DriveError

PATIENCE: Final = 5
"""Periods without a command after which the arm stops by itself, and without a sample after which the drive stops."""
AWAY: Final = 0.01
"""Largest distance of a held joint from the graph's angle [rad]."""


class ArmJoints:
    """Maps the graph's joints to all joints of an arm, and counts lost samples.

    Parameters
    ----------
    name
        Name in messages.
    period
        Sampling period of the graph [s].
    known
        All joints of the arm, in its order.
    joints
        Joints of the graph, in its order; the others are held.
    held
        Angles of the held joints in the graph [rad]; 0 by default.
    """

    def __init__(
        self, name: str, period: float, known: Sequence[str], joints: Sequence[str], held: Mapping[str, float]
    ) -> None:
        self.name, self.period, self._known = name, period, tuple(known)
        self.places = [self._known.index(joint) for joint in joints]
        self.held = {k: held.get(joint, 0.0) for k, joint in enumerate(known) if joint not in joints}
        self.last = float("nan")

    def speeds(self, dq: np.ndarray) -> np.ndarray:
        """Speeds of all joints, zero for held ones [rad/s]."""
        found = np.zeros(len(self._known))
        found[self.places] = dq
        return found

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Angles of all joints, those of the graph for held ones [rad]."""
        found = self.speeds(q)
        for k, angle in self.held.items():
            found[k] = angle
        return found

    def check_held(self, q: Sequence[float]) -> None:
        """Check that held joints are at the graph's angles, on which the tool position depends. Raises `DriveError`."""
        for k, angle in self.held.items():
            if abs(q[k] - angle) > AWAY:
                raise DriveError(
                    f"{self.name}: expected {self._known[k]} at {angle:.4g} rad, where the graph holds it, found it at "
                    f"{q[k]:.4g} rad"
                )

    def begin(self) -> None:
        """Do not count samples before the next one as lost."""
        self.last = float("nan")

    def missed(self, time: float) -> int:
        """Number of samples lost before that at `time` [s]."""
        steps = (time - self.last) / self.period
        self.last = float(np.fmax(self.last, time))
        return max(0, round(steps) - 1) if np.isfinite(steps) else 0


def motion_timeout(now: np.ndarray, goal: np.ndarray, speed: float, acceleration: float) -> float:
    """Timeout of a motion to a pose [s]."""
    return float(np.max(np.abs(goal - now))) / speed + 2 * speed / acceleration + 5
