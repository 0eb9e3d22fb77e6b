"""Samples of Universal Robots' arms from RTDE's values, common to both drivers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, final

import numpy as np

from dmframe.common.errors import DriveError
from dmframe.runtime.arm import ArmJoints
from dmframe.runtime.robot import Sample

JOINTS: Final = tuple(
    f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
)
ANSWER: Final = 2.0
"""Timeout of answers outside the control loop [s]."""
OFF: Final = 0.05
"""Tolerance for the time between samples as a whole number of periods [periods]."""
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
class UrArm(ArmJoints):
    """Joints of a UR, and its samples.

    Parameters
    ----------
    tool
        q -> x, the graph's kinematics; the robot's own pose is in another frame.
    """

    def __init__(
        self,
        name: str,
        period: float,
        joints: Sequence[str],
        tool: Callable[[np.ndarray], np.ndarray],
        held: Mapping[str, float],
    ) -> None:
        super().__init__(name, period, JOINTS, joints, held)
        self.tool = tool

    def check_period(self, first: float, second: float) -> None:
        """Check that two samples [s] are a whole number of the graph's periods apart. Raises `DriveError`.

        An arm whose cycle does not divide the period sends its samples with another period.
        """
        periods = (second - first) / self.period
        if periods < 0.5 or abs(periods - round(periods)) > OFF:
            raise DriveError(
                f"{self.name}: expected samples {self.period * 1e3:g} ms apart, the graph's clock, found "
                f"{(second - first) * 1e3:g} ms; set a multiple of the arm's cycle: --set clock='8 ms'"
            )

    def sample(self, values: Mapping[str, Any], *, following: bool, age: float | None) -> Sample:
        """Convert RTDE's values; with `following`, the end of the driver's script is a fault."""
        mode, stamp = values["safety_mode"], values["timestamp"]
        fault = MODES.get(mode, f"safety mode {mode}") if mode not in SAFE else ""
        if not fault and following and values["runtime_state"] != PLAYING:
            fault = "its script has ended"
        q = np.array(values["actual_q"])[self.places]
        return Sample(
            time=stamp,
            q=q,
            dq=np.array(values["actual_qd"])[self.places],
            q_c=np.array(values["target_q"])[self.places],
            x=np.asarray(self.tool(q)).ravel(),
            scaling=min(1.0, max(0.0, values["speed_scaling"] * values["target_speed_fraction"])),
            ready=values["robot_mode"] == RUNNING,
            fault=fault,
            age=age,
            missed=self.missed(stamp),
        )
