"""Packages of a UR's primary, secondary and real-time ports, as far as clients need them to start."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final

import numpy as np

from dmframe.virtual.safety import EMERGENCY, PROTECTIVE

if TYPE_CHECKING:
    from dmframe.virtual.robot import VirtualRobot

PROJECT: Final = b"URControl"
STATE: Final = 16
MESSAGE: Final = 20
NO_LIMIT: Final = 1e3
DEFAULTS: Final = (1.05, 1.4, 0.25, 1.2, 0.1)
"""Default speed and acceleration of the joints and of the tool, and blend radius, in SI units."""
REAL_TIME: Final = {"cb3": 1060, "e": 1108}
"""Size of a package of the real-time port [bytes]."""


def greeting(robot: VirtualRobot) -> bytes:
    """Version message, the first on the primary port."""
    major, minor, bugfix, build = robot.version
    text = struct.pack(">B", len(PROJECT)) + PROJECT + struct.pack(">BBii", major, minor, bugfix, build) + b"virtual"
    body = struct.pack(">QbB", int(robot.time * 1e6), -2, 3) + text
    return _package(MESSAGE, body)


def state(robot: VirtualRobot) -> bytes:
    """State message: the robot's mode, joints, flange pose and configuration."""
    parts = ((0, _mode(robot)), (1, _joints(robot)), (4, _flange(robot)), (6, _configuration(robot)))
    return _package(STATE, b"".join(struct.pack(">IB", 5 + len(body), kind) + body for kind, body in parts))


def _package(kind: int, body: bytes) -> bytes:
    return struct.pack(">IB", 5 + len(body), kind) + body


def _mode(robot: VirtualRobot) -> bytes:
    safety = robot.safety
    stops = (safety.mode == EMERGENCY, safety.mode == PROTECTIVE)
    flags = (True, True, safety.powered, *stops, robot.running, False)
    return struct.pack(
        ">Q7?BBdddB", int(robot.time * 1e6), *flags, safety.robot_mode, 0, robot.slider, robot.scaling, 1.0, 0
    )


def _joints(robot: VirtualRobot) -> bytes:
    rows = zip(robot.q, robot.target.q, robot.dq, strict=True)
    return b"".join(struct.pack(">dddffffB", *row, 0.0, 48.0, 25.0, 25.0, robot.safety.joint_mode) for row in rows)


def _flange(robot: VirtualRobot) -> bytes:
    return struct.pack(">12d", *robot.arm.pose(robot.q), *(0.0,) * 6)


def _configuration(robot: VirtualRobot) -> bytes:
    arm = robot.arm
    lower, upper, speed = (np.nan_to_num(values, posinf=NO_LIMIT, neginf=-NO_LIMIT) for values in
                           (arm.lower, arm.upper, arm.velocity))  # fmt: skip
    limits = np.column_stack([lower, upper]).ravel()
    motion = np.column_stack([speed, np.full(6, 40.0)]).ravel()
    # Denavit-Hartenberg lengths are zeros: the model has other frames
    return struct.pack(">12d12d5d24d4I", *limits, *motion, *DEFAULTS, *(0.0,) * 24, 0, 0, _robot_type(robot), 0)


def _robot_type(robot: VirtualRobot) -> int:
    return {"ur5": 1, "ur3": 3}.get(robot.arm.name.lower()[:3], 2)


def real_time(robot: VirtualRobot) -> bytes:
    """Package of the real-time port; values that the model does not have are zero."""
    count = (REAL_TIME[robot.series] - 4) // 8
    numbers = np.zeros(count)
    numbers[0] = robot.time
    target = robot.target
    for first, values in ((1, target.q), (7, target.qd), (13, target.qdd), (25, robot.torque), (31, robot.q)):
        numbers[first : first + 6] = values
    numbers[37:43] = robot.dq
    numbers[55:61] = robot.arm.pose(robot.q)
    numbers[73:79] = robot.arm.pose(robot.target.q)
    numbers[94] = robot.safety.robot_mode
    numbers[95:101] = robot.safety.joint_mode
    numbers[101] = robot.safety.mode
    numbers[117] = robot.scaling
    return struct.pack(f">I{count}d", REAL_TIME[robot.series], *numbers)
