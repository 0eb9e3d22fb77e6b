"""What is common to all drivers of Universal Robots' arms: six joints, of which a graph has some; modes by the maker's
numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, final

import numpy as np

from dmframe.errors import DriveError
from dmframe.runtime.robot import Sample

JOINTS: Final = tuple(
    f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
)
PATIENCE: Final = 5
"""Periods without a heartbeat after which the arm comes to rest by itself, and without a sample after which we do."""
ANSWER: Final = 2.0
"""How long we wait for what is not a sample of the loop [s]."""
AWAY: Final = 0.01
"""How far a joint may be from where the graph holds it [rad]."""
OFF: Final = 0.05
"""How far from a whole number of periods samples may be apart, in periods."""
RUNNING, PLAYING = 7, 2
SAFE: Final = (1, 2)
MODES: Final = {
    3: "protective stop",
    4: "recovery",
    5: "safeguard stop",
    6: "emergency stop of the system",
    7: "emergency stop of the robot",
    8: "violation",
    9: "fault",
}


@final
class UrArm:
    """An arm as a graph has it.

    Parameters
    ----------
    name
        As messages call it.
    period
        The graph's clock [s].
    joints
        The graph's, in its order; the others of the six are held.
    tool
        q -> x, the graph's own kinematics: the maker's pose is in another frame.
    held
        Where the graph holds the others of the six [rad]; 0 without a word.
    """

    def __init__(
        self,
        name: str,
        period: float,
        joints: Sequence[str],
        tool: Callable[[np.ndarray], np.ndarray],
        held: Mapping[str, float],
    ) -> None:
        self.name, self.period, self.tool = name, period, tool
        self._places = [JOINTS.index(joint) for joint in joints]
        self._held = {JOINTS.index(joint): held.get(joint, 0.0) for joint in JOINTS if joint not in joints}
        self._last = float("nan")

    @property
    def n(self) -> int:
        """The number of the graph's joints."""
        return len(self._places)

    def speeds(self, dq: np.ndarray) -> np.ndarray:
        """(6,) with zeros for joints that are held [rad/s]."""
        six = np.zeros(6)
        six[self._places] = dq
        return six

    def pose(self, q: np.ndarray) -> np.ndarray:
        """(6,) with the joints that are held where the graph holds them [rad]."""
        six = np.zeros(6)
        six[self._places] = q
        for k, angle in self._held.items():
            six[k] = angle
        return six

    def check_held(self, q: Sequence[float]) -> None:
        """Raise `DriveError` where a joint that the graph holds is elsewhere, so that the tool is, too."""
        for k, angle in self._held.items():
            if abs(q[k] - angle) > AWAY:
                raise DriveError(
                    f"{self.name}: expected {JOINTS[k]} at {angle:.4g} rad, where the graph holds it, found it at "
                    f"{q[k]:.4g} rad"
                )

    def check_period(self, first: float, second: float) -> None:
        """Raise `DriveError` for two times of samples [s] that are not some of the graph's periods apart.

        An arm whose cycle does not divide the period sends samples in another one, unasked.
        """
        periods = (second - first) / self.period
        if periods < 0.5 or abs(periods - round(periods)) > OFF:
            raise DriveError(
                f"{self.name}: expected samples {self.period * 1e3:g} ms apart, the graph's clock, found "
                f"{(second - first) * 1e3:g} ms; set one that the arm's cycle divides: --set clock='8 ms'"
            )

    def begin(self) -> None:
        """Count no samples as lost that came before the next one."""
        self._last = float("nan")

    def sample(self, told: Mapping[str, Any], *, following: bool, age: float | None) -> Sample:
        """What the arm tells, by RTDE's names; `following` where a script of ours should run."""
        mode, stamp = told["safety_mode"], told["timestamp"]
        fault = MODES.get(mode, f"safety mode {mode}") if mode not in SAFE else ""
        if not fault and following and told["runtime_state"] != PLAYING:
            fault = "its script has ended"
        q = np.array(told["actual_q"])[self._places]
        steps = (stamp - self._last) / self.period
        self._last = stamp if np.isnan(self._last) else max(self._last, stamp)
        return Sample(
            time=stamp,
            q=q,
            dq=np.array(told["actual_qd"])[self._places],
            q_c=np.array(told["target_q"])[self._places],
            x=np.asarray(self.tool(q)).ravel(),
            scaling=min(1.0, max(0.0, told["speed_scaling"] * told["target_speed_fraction"])),
            ready=told["robot_mode"] == RUNNING,
            fault=fault,
            age=age,
            missed=max(0, round(steps) - 1) if np.isfinite(steps) else 0,
        )


def way_time(now: np.ndarray, goal: np.ndarray, speed: float, acceleration: float) -> float:
    """How long a way may take before something is wrong [s]."""
    return float(np.max(np.abs(goal - now))) / speed + 2 * speed / acceleration + 5
