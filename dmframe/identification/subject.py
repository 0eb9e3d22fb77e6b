"""Robot of an experiment, from a name, a robot file or a graph: its chain, start, collision shapes and plant."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final
from xml.etree import ElementTree

import numpy as np

from dmframe.block.port import Side
from dmframe.catalogue import find_graph, graphs
from dmframe.common.errors import LISTS, UnknownNameError, ValueFault
from dmframe.drive.drive import start_angles
from dmframe.graph.first import first_graph, is_robot
from dmframe.graph.graph import Graph
from dmframe.identification.log import Array
from dmframe.robot.chain import SerialChain
from dmframe.robot.convert import read_any
from dmframe.robot.library import find_robot, robots
from dmframe.robot.urdf import read_urdf

ARM: Final = 6
"""Joints of a robot that a URScript program moves."""


@final
@dataclass(frozen=True, eq=False)
class Subject:
    """A robot that is to be excited.

    Parameters
    ----------
    name
        As the user wrote it.
    chain
        Its moving joints.
    robot, plant, wires
        Sections of a graph: the robot, the blocks of its closed servo and arm, and their wires.
    files
        Robot files that the graph needs next to it, by name.
    start
        (n,), start posture of the graph [rad, m].
    shapes
        URDF tree with collision shapes, and the folder of its meshes.
    period
        Clock of the graph [s]; None for another source, or in continuous time.
    arm
        Names of all moving joints of the file, with the positions of those that are held.
    own
        True if the start posture is that of a user's graph.
    """

    name: str
    chain: SerialChain
    robot: dict[str, Any]
    plant: dict[str, Any]
    wires: dict[str, Any]
    files: Mapping[str, str]
    start: Array
    shapes: tuple[ElementTree.Element, Path] | None
    period: float | None
    arm: dict[str, float]
    own: bool

    def spread(self, values: Array) -> Array:
        """Rows of all moving joints of the file: held joints at their positions."""
        rows = np.tile(list(self.arm.values()), (len(values), 1))
        rows[:, [list(self.arm).index(name) for name in self.chain.joint_names]] = values
        return rows


def subject_of(name: str) -> Subject:
    """The robot of a packaged or user's graph, of a robot's name, or of a URDF, xacro or MJCF file.

    Raises
    ------
    DmframeError
        There is none of this name, or its graph has no robot.
    """
    if name.endswith((".yaml", ".yml")) or name in graphs():
        return _of_graph(name, Graph.read(name), find_graph(name).parent, {}, None, own=True)
    if not is_robot(name):
        raise UnknownNameError(name, "graph or robot", name, {*graphs(), *robots()}, spelling=False, others=LISTS)
    with tempfile.TemporaryDirectory() as place:
        made = first_graph(name, Path(place))
        for model, text in made.robot.items():
            (Path(place) / model).write_text(text, encoding="utf-8")
        file = Path(place) / "graph.yaml"
        file.write_text(made.text, encoding="utf-8")
        origin = Path(name).expanduser() if name not in robots() else None
        return _of_graph(name, Graph.read(file), Path(place), made.robot, origin, own=False)


def _of_graph(
    name: str, graph: Graph, folder: Path, files: Mapping[str, str], origin: Path | None, *, own: bool
) -> Subject:
    chain, section = graph.diagram.robot, graph.file.robot
    if not isinstance(chain, SerialChain) or section is None:
        raise ValueFault(f"{name}: expected a graph with a robot, found none")
    source = find_robot(section.model, folder)
    given = graph.data["robot"]
    robot = {"model": given} if isinstance(given, str) else dict(given)
    if section.model not in robots() and section.model not in files:
        robot["model"] = str(source.urdf.resolve())
    plant = {}
    for block, data in dict(graph.data["blocks"]).items():
        if data is None or graph.blocks[block].side is not Side.PLANT:
            continue
        data = dict(data)
        kind = str(data["type"])
        if ".py:" in kind:
            data["type"] = str((folder / kind).resolve())
        plant[block] = data
    wires = {
        port: source
        for port, source in dict(graph.data.get("wires") or {}).items()
        if {str(port).partition(".")[0], str(source).partition(".")[0]} <= set(plant)
    }
    start = start_angles(graph)
    assert start is not None  # a graph with a robot has joint angles
    file = origin or source.urdf
    model, _ = read_urdf(source.urdf, free=chain.joint_names)
    names = [model.names[i] for i in range(1, model.njoints) if model.joints[i].nq == 1]
    held = dict(source.hold) | dict(section.hold)
    return Subject(
        name,
        chain,
        robot,
        plant,
        wires,
        files,
        np.asarray(start, dtype=float),
        (read_any(file).root, file.parent),
        graph.file.clock if own else None,
        {joint: float(held.get(joint, 0.0)) for joint in names},
        own,
    )
