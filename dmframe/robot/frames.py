"""Frames of a robot's joints and tool, for drawings."""

from __future__ import annotations

from typing import Any

import casadi as ca

from dmframe.robot.symbolic import SymbolicRobot


def frames(robot: SymbolicRobot, q: Any) -> Any:
    """Joint frames at q in the base's frame: rotation, column by column, and origin [m], SX (12, n)."""
    rotation, origin, found = ca.SX.eye(3), ca.SX(3, 1), []
    for link in robot.links(q):
        origin = origin + rotation @ link.offset
        rotation = rotation @ link.rotation
        found.append(ca.vertcat(ca.vec(rotation), origin))
    return ca.densify(ca.horzcat(*found))


def tool(robot: SymbolicRobot, q: Any) -> Any:
    """Tool position in the base's frame [m], including coordinates that are not part of the task, SX (3)."""
    last = frames(robot, q)[:, -1]
    return last[9:] + ca.reshape(last[:9], 3, 3) @ robot.a_k[-3:]
