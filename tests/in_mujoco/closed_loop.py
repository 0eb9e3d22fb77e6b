"""The exported controller of a packaged graph with its plant in MuJoCo, and `run` of the same graph."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np

import dmframe as dm
from dmframe.robot.library import find_robot
from tests.exported_controller import ExportedController
from tests.in_mujoco.plant import Motion, Plant
from tests.in_mujoco.servos import Array, Pid

Settings = Mapping[str, Any]


@cache
def controller(name: str) -> ExportedController:
    """The controller of a graph as it is packaged, compiled from its export."""
    folder = Path(mkdtemp(prefix="in-mujoco-"))
    dm.load(name).export(folder / name)
    return ExportedController(folder / name / f"{name}.c", folder)


def numbers(graph: Any) -> dict[str, Array]:
    """Parameters of a graph's blocks, one number per joint even if the block has one for all."""
    n = graph.diagram.robot.n
    found = {leaf.label: np.asarray(leaf.value, dtype=float) for leaf in graph.diagram.loop.parameters}
    return {label: np.full(n, value) if value.ndim == 0 else value for label, value in found.items()}


def held(graph: Any) -> dict[str, float]:
    """The joints of the URDF that the graph fixes, by their angles [rad]."""
    robot = graph.file.robot
    joints = ET.parse(find_robot(robot.model).urdf).getroot().findall("joint")
    names = [str(joint.get("name")) for joint in joints if joint.get("type") in ("revolute", "continuous")]
    return {name: (robot.hold or {}).get(name, 0.0) for name in names if robot.free and name not in robot.free}


def plant_of(graph: Any, **changes: Any) -> Plant:
    """The arm, friction, rotors and PID servo of a graph, except for changed values."""
    value, robot = numbers(graph), graph.file.robot
    if "servo" not in changes:
        changes["servo"] = Pid(value["servo.K_D"], value["servo.K_P"], value["servo.K_I"])
    given = {
        "urdf": find_robot(robot.model).urdf,
        "tool": robot.tool,
        "hold": held(graph),
        "viscous": value["arm.viscous"],
        "coulomb": value["arm.coulomb"],
        "v_0": float(value["robot.friction_velocity"][0]),
        "rotor": tuple(value["arm.rotor"]) if "arm.rotor" in value else (),
    }
    return Plant(**(given | changes))


def in_mujoco(name: str, seconds: float, settings: Settings | None = None, **changes: Any) -> Motion:
    """A packaged graph's controller with its plant, with other settings of the plant's blocks, in MuJoCo."""
    graph, law = dm.load(name).set(dict(settings or {})), controller(name)
    labels = [leaf.name for leaf in graph.diagram.loop.measured]
    law.init()

    def command(measured: dict[str, Array], t: float) -> Array:
        given = np.concatenate([measured[label] for label in labels])
        assert t > 0 or law.reset(given, t)
        commanded = law.step(given, t)
        assert commanded is not None, f"{name} refuses the sample at {t:g} s"
        return commanded

    return plant_of(graph, **changes).run(command, graph.start["q"], float(graph.clock), seconds)


def in_dmframe(name: str, seconds: float, settings: Settings | None = None) -> Any:
    """The record of `run` of a packaged graph, with other settings."""
    done = dm.load(name).set(dict(settings or {})).run(seconds, progress=False)
    assert done.recording.divergence is None
    return done.recording


def error(x: Array, x_d: Array) -> float:
    """RMS of the tool's error over the last eighth [mm]."""
    size = 1e3 * np.linalg.norm(x - x_d, axis=1)
    return float(np.sqrt(np.mean(size[-(size.size // 8) :] ** 2)))
