"""Safety and robot modes of a UR: running, protective stop, emergency stop, power off."""

from __future__ import annotations

from typing import Final, final

NORMAL: Final = 1
PROTECTIVE: Final = 3
EMERGENCY: Final = 7
SAFETY_NAMES: Final = {NORMAL: "NORMAL", PROTECTIVE: "PROTECTIVE_STOP", EMERGENCY: "ROBOT_EMERGENCY_STOP"}

POWER_OFF: Final = 3
IDLE: Final = 5
RUNNING: Final = 7
MODE_NAMES: Final = {POWER_OFF: "POWER_OFF", IDLE: "IDLE", RUNNING: "RUNNING"}


@final
class Safety:
    """State machine of the safety and robot modes.

    Attributes
    ----------
    mode, robot_mode
        UR's numbers of the safety mode and the robot mode.
    reason
        Reason of the last stop; empty before the first.
    """

    def __init__(self) -> None:
        self.mode, self.robot_mode, self.reason = NORMAL, RUNNING, ""

    @property
    def ready(self) -> bool:
        """True if the robot may move."""
        return self.mode == NORMAL and self.robot_mode == RUNNING

    @property
    def powered(self) -> bool:
        """True if the arm has power."""
        return self.robot_mode != POWER_OFF

    @property
    def joint_mode(self) -> int:
        """UR's number of each joint's mode: running, idle or off."""
        return {RUNNING: 253, IDLE: 255}.get(self.robot_mode, 239)

    @property
    def bits(self) -> int:
        """RTDE's safety status bits."""
        return {NORMAL: 1 << 0, PROTECTIVE: 1 << 2 | 1 << 10, EMERGENCY: 1 << 6 | 1 << 7 | 1 << 10}[self.mode]

    def stop(self, mode: int, reason: str) -> bool:
        """Enter a stop mode, unless the present one is graver; True if the mode changed."""
        if mode <= self.mode:
            return False
        self.mode, self.reason = mode, reason
        if mode == EMERGENCY:
            self.robot_mode = POWER_OFF
        return True

    def release(self, mode: int) -> bool:
        """Leave this stop mode; False if the robot is not in it."""
        if self.mode != mode:
            return False
        self.mode = NORMAL
        return True

    def power(self, robot_mode: int) -> bool:
        """Switch the power, or release the brakes; False in an emergency stop, or without power."""
        if self.mode == EMERGENCY and robot_mode != POWER_OFF:
            return False
        if robot_mode == RUNNING and self.robot_mode == POWER_OFF:
            return False
        self.robot_mode = robot_mode
        return True
