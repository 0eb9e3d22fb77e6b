"""A path of a file as a block for a graph."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np
from ruamel.yaml import YAML

from dmframe.common.errors import ValueFault
from dmframe.design.motion import first_path
from dmframe.design.path_file import read_path
from dmframe.design.points import MANY, After, Points, points_of, tool_points_of
from dmframe.graph.first import first_graph, is_robot
from dmframe.graph.load import load
from dmframe.identification.race_text import dumped
from dmframe.robot.chain import SerialChain
from dmframe.robot.library import load as load_robot


@final
@dataclass(frozen=True)
class PathBlock:
    """A path as a block, the start of the robot on it, and what was changed.

    Parameters
    ----------
    start
        Key ``start`` of the graph; empty for a path of the tool, which the robot's start has to fit.
    """

    block: Mapping[str, Any]
    start: Mapping[str, Any]
    notes: tuple[str, ...]

    def __str__(self) -> str:
        lines = "".join(f"# {note}\n" for note in self.notes)
        start = dumped({"start": dict(self.start)}) if self.start else ""
        body = dumped({"path": dict(self.block)})
        return f"{lines}{start}blocks:\n" + "".join(f"  {line}\n" for line in body.splitlines())


def path_block(
    file: str | Path,
    robot: str,
    *,
    joints: bool = False,
    after: After = "stays",
    tool: str | None = None,
    hold: Mapping[str, float] | None = None,
) -> PathBlock:
    """The block `waypoints` of a path from a CSV file or a ROS ``JointTrajectory``.

    Parameters
    ----------
    robot
        Name or file of a robot, or a graph, whose robot is taken.
    joints
        Compute the joint positions of a path of the tool by inverse kinematics, and write `joint_waypoints`.
    after
        What the path does after its last point.
    tool, hold
        As in `first_graph`; not with a graph.

    Raises
    ------
    DmframeError
        The file has no path of this robot, or the robot cannot follow it.
    """
    chain, near = _chain(robot, tool, dict(hold or {}))
    found = read_path(file, chain)
    if found.kind == "joints" or joints:
        points = points_of(found, chain, near, np.inf, MANY)
        kind = "waypoints" if found.kind == "joints" else "joint_waypoints"
        _check_after(after, points)
        return PathBlock(points.block(kind, after), {"q": points.block(kind, after)["q_d"][0]}, points.notes)
    if found.kind == "pose":
        raise ValueFault(
            "a path with orientations: expected --joints, which computes the joint positions, or columns x, y, z alone",
            location=found.name,
        )
    points = tool_points_of(found, chain.axes)
    _check_after(after, points)
    return PathBlock(points.block("waypoints", after, "x_d"), {}, points.notes)


def _check_after(after: After, points: Points) -> None:
    if after == "repeats" and points.after != "repeats":
        raise ValueFault("after: expected stays or returns, since the path does not end where it begins; found repeats")


def _chain(robot: str, tool: str | None, hold: dict[str, float]) -> tuple[SerialChain, np.ndarray]:
    """The robot, and a posture near which a path of the tool starts."""
    if is_robot(robot):
        first = first_graph(robot, Path(), tool, hold)
        if first.robot:
            raise ValueFault(f"{robot}: write a graph for it with dmframe new, and give the graph")
        section = YAML(typ="safe").load(first.text)["robot"]
        given: dict[str, Any] = {"model": section} if isinstance(section, str) else section
        near = np.array(first_path(first)["center"], dtype=float)
        return load_robot(given["model"], tool=given.get("tool"), hold=given.get("hold") or {}), near
    if tool is not None or hold:
        raise ValueFault("expected --tool and --hold with a robot, found a graph, which has its own")
    graph = load(robot)
    chain = graph.robot
    if not isinstance(chain, SerialChain):
        raise ValueFault(f"{robot}: expected a graph with a robot")
    return chain, np.asarray(graph.start.get("q", np.zeros(chain.n)), dtype=float)
