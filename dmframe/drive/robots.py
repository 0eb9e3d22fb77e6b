"""Drivers by the name that a user types: ``sim``, ``sim:2``, ``ur:192.168.0.2``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from dmframe.block.model import SYMBOLIC
from dmframe.common.errors import DriveError, UnknownNameError, ValueFault
from dmframe.config import BaseGraph
from dmframe.diagram import Diagram
from dmframe.robot.symbolic import tool_position
from dmframe.runtime import xarm
from dmframe.runtime.robot import Robot
from dmframe.runtime.simulated import SimulatedRobot, loaded
from dmframe.runtime.ur import UniversalRobot
from dmframe.runtime.ur_arm import JOINTS
from dmframe.runtime.ur_rtde import UrRtde
from dmframe.simulate.engine import Choice

MOST_DELAY: Final = 100


@final
@dataclass(frozen=True)
class Options:
    """Options of a driver.

    Parameters
    ----------
    duration
        Duration of the drive [s].
    halt
        Deceleration of the robot when commands stop [rad/s^2].
    patience
        Timeout of a sample [s]; None for the driver's default.
    """

    duration: float
    engine: Choice = "auto"
    halt: float = 20.0
    patience: float | None = None


@final
@dataclass(frozen=True)
class Kind:
    """Kind of driver.

    Parameters
    ----------
    real
        True for hardware, which requires limits and a rehearsal.
    make
        Creates the driver from the text after the colon, the graph and the options.
    """

    real: bool
    make: Callable[[str, BaseGraph, Options], Robot]


def simulated_robot(graph: BaseGraph, duration: float, engine: Choice = "auto", **options: Any) -> SimulatedRobot:
    """Simulated robot of the graph; options as in `SimulatedRobot`."""
    own = {key: graph.settings[key] for key in ("start", "solver", "seed", "jitter")}
    return SimulatedRobot(graph.diagram, clock_of(graph), duration=duration, engine=engine, **{**own, **options})


def clock_of(graph: BaseGraph) -> float:
    """Sampling period [s]. Raises `DriveError` in continuous time."""
    clock = graph.file.clock
    if clock is None:
        raise DriveError(f"{graph.name}: expected a clock such as 8 ms, found continuous; set one: --set clock='8 ms'")
    return clock


def usual_payload(diagram: Diagram) -> float:
    """A twentieth of the moving mass, rounded to one digit [kg]; 0 for a robot without masses."""
    try:
        _ = loaded(diagram.loop, 1.0)
    except DriveError:
        return 0.0
    masses = next(item for item in diagram.loop.parameters if item.label == "robot.inertia").value.ravel()[::10]
    return float(f"{masses.sum() / 20:.1g}")


def _simulated(text: str, graph: BaseGraph, options: Options) -> Robot:
    if text and not (text.isascii() and text.isdigit() and int(text) <= MOST_DELAY):
        raise ValueFault(
            f"--robot sim:{text}: expected a delay of commands in samples, such as sim:2, at most {MOST_DELAY}"
        )
    return simulated_robot(graph, options.duration, options.engine, delay=int(text or 0))


def _universal(text: str, graph: BaseGraph, options: Options) -> Robot:
    return UniversalRobot(*_arm("ur", text, graph), halt=options.halt, patience=options.patience)


def _by_ur_rtde(text: str, graph: BaseGraph, options: Options) -> Robot:
    return UrRtde(*_arm("ur_rtde", text, graph), patience=options.patience)


def _arm(kind: str, text: str, graph: BaseGraph) -> tuple[Any, ...]:
    """Arguments of both UR drivers: address, period, joints, kinematics, and angles of held joints."""
    if not text:
        raise ValueFault(f"--robot {kind}: expected the address of an arm, {kind}:192.168.0.2")
    robot = graph.diagram.robot
    _check_joints(robot, JOINTS, f"--robot {kind}: expected the joints of a UR")
    return text, clock_of(graph), robot.joint_names, _tool(robot), _holds(graph)


def _xarm(text: str, graph: BaseGraph, options: Options) -> Robot:
    if not text:
        raise ValueFault("--robot xarm: expected the address of an arm, xarm:192.168.1.2")
    robot = graph.diagram.robot
    _check_joints(robot, xarm.JOINTS, "--robot xarm: expected the joints of an xArm, joint1 to joint7,")
    hold = _holds(graph)
    return xarm.XArm(text, clock_of(graph), robot.joint_names, _tool(robot), hold, patience=options.patience)


def _check_joints(robot: Any, known: Sequence[str], expected: str) -> None:
    strange = [name for name in robot.joint_names if name not in known] if robot is not None else ["no joints"]
    if strange or list(robot.joint_names) != [name for name in known if name in robot.joint_names]:
        raise DriveError(f"{expected} in their order, found {', '.join(strange) or 'another'}")


def _holds(graph: BaseGraph) -> dict[str, float]:
    """Angles of the joints that the graph holds [rad]."""
    section = graph.file.robot
    return dict(section.hold) if section is not None else {}


def _tool(robot: Any) -> Callable[[np.ndarray], np.ndarray]:
    """Tool position as a function of q, with the graph's lengths."""
    with SYMBOLIC:
        found = tool_position(robot)
    return lambda q: np.asarray(found(q)).ravel()


KINDS: Final[dict[str, Kind]] = {
    "sim": Kind(real=False, make=_simulated),
    "ur": Kind(real=True, make=_universal),
    "ur_rtde": Kind(real=True, make=_by_ur_rtde),
    "xarm": Kind(real=True, make=_xarm),
}
"""Kind of driver by the text before the colon."""


def kind_of(name: str) -> tuple[Kind, str]:
    """Kind of driver, and the text after the colon. Raises `UnknownNameError`."""
    word, _, rest = name.partition(":")
    if word not in KINDS:
        raise UnknownNameError(f"--robot {name}", "kind of robot", word, KINDS)
    return KINDS[word], rest
