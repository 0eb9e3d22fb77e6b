"""Where the joints and the tool of a robot are, for whoever draws it."""

from __future__ import annotations

from typing import Any

import casadi as ca

from dmframe.robot.symbolic import SymbolicRobot


def frames(robot: SymbolicRobot, q: Any) -> Any:
    """Each joint's frame at q in the base's: its rotation, column by column, and its origin [m], SX (12, n)."""
    rotation, origin, found = ca.SX.eye(3), ca.SX(3, 1), []
    for link in robot.links(q):
        origin = origin + rotation @ link.offset
        rotation = rotation @ link.rotation
        found.append(ca.vertcat(ca.vec(rotation), origin))
    return ca.densify(ca.horzcat(*found))


def tool(robot: SymbolicRobot, q: Any) -> Any:
    """The tool in the base's frame [m], with the coordinates that are no task, too, SX (3)."""
    last = frames(robot, q)[:, -1]
    return last[9:] + ca.reshape(last[:9], 3, 3) @ robot.a_k[-3:]
