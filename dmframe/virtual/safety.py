"""The modes of a UR: running, stopped for protection, stopped in emergency, without power."""

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
    """In which mode the robot is, and why.

    Attributes
    ----------
    mode, robot_mode
        By the maker's numbers.
    reason
        Of the last stop, for a reader; empty before there was one.
    """

    def __init__(self) -> None:
        self.mode, self.robot_mode, self.reason = NORMAL, RUNNING, ""

    @property
    def ready(self) -> bool:
        """True where the robot may move."""
        return self.mode == NORMAL and self.robot_mode == RUNNING

    @property
    def powered(self) -> bool:
        """True where the arm has power."""
        return self.robot_mode != POWER_OFF

    @property
    def joint_mode(self) -> int:
        """Of each joint: running, idle or off."""
        return {RUNNING: 253, IDLE: 255}.get(self.robot_mode, 239)

    @property
    def bits(self) -> int:
        """Of RTDE: normal, protective stop, and emergency stop of the robot, of any kind, and stopped by safety."""
        return {NORMAL: 1 << 0, PROTECTIVE: 1 << 2 | 1 << 10, EMERGENCY: 1 << 6 | 1 << 7 | 1 << 10}[self.mode]

    def stop(self, mode: int, reason: str) -> bool:
        """Go to a stop, if it is not in a graver one; True where that is new."""
        if mode <= self.mode:
            return False
        self.mode, self.reason = mode, reason
        if mode == EMERGENCY:
            self.robot_mode = POWER_OFF
        return True

    def release(self, mode: int) -> bool:
        """Leave a stop of this kind; False where the robot is not in it."""
        if self.mode != mode:
            return False
        self.mode = NORMAL
        return True

    def power(self, robot_mode: int) -> bool:
        """Turn power on or off, or the brakes off; False where the robot is in emergency."""
        if self.mode == EMERGENCY and robot_mode != POWER_OFF:
            return False
        if robot_mode == RUNNING and self.robot_mode == POWER_OFF:
            return False
        self.robot_mode = robot_mode
        return True
