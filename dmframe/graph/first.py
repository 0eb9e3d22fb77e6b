"""First graph of a robot: an adaptive law in joint space with gains from the robot's own inertia.

The servo that the simulated robot hides is a placeholder, a PID servo of positions. Its gains scale with the largest
inertia of each joint, as do those of the law, so that the loop's rates are the same for a small and a large robot, and
are larger where the weight of the arm requires it. Rotors and friction are placeholders in the proportions of a UR10e.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from dmframe.common.errors import RobotError, listed
from dmframe.common.files import ROBOT_FILES
from dmframe.robot.chain import Joint, SerialChain, pin_configuration
from dmframe.robot.convert import Element, joints_to, read_any, written
from dmframe.robot.flange import AXES, MOVING, flange_of
from dmframe.robot.library import find_robot, load, robots
from dmframe.robot.repairs import implausible_values, impossible_inertias, repaired
from dmframe.robot.urdf import check_parts
from dmframe.robot.urdf_numbers import faults_of_tree

RATE: Final = 80.0
"""Bandwidth of the servo's velocity loop at the largest inertia of a joint [rad/s]."""
RATIO_P: Final = 2.2
RATIO_I: Final = 0.7
"""K_P/K_D [1/s] and K_I/K_D [1/s^2] of the servo."""
SAG: Final = {"revolute": 0.05, "prismatic": 0.01}
"""Most deflection of the servo's proportional part under the weight of the arm [rad, m]."""
ROTOR: Final = (0.4, 0.03)
"""Rotor inertia of a joint relative to that of the links, and its least value relative to the largest joint's."""
VISCOUS: Final = 1 / 40
COULOMB: Final = 1 / 50
"""Friction relative to K_D, as that of a real UR10e to the servo of the packaged UR10 [-, rad/s]."""
MOST_VISCOUS: Final = 0.15
MOST_COULOMB: Final = 0.12
"""Largest placeholders of friction relative to a joint's torque limit: a motor can turn its own joint [s/rad, -]."""
PERIOD: Final = 0.008
"""Sampling period [s]."""
STEP: Final = 0.2
"""Fraction of an error that adaptation may remove within one sample; from 2 on it diverges."""
EFFORT: Final = 0.35
"""Fraction of a joint's torque limit up to which its weight does not count against a posture: the motion, friction and
a load need the rest."""
SAMPLES: Final = 400
"""Postures tried for the centre of the motion."""
REACH: Final = {"revolute": 0.25, "prismatic": 0.05}
"""Largest amplitude [rad, m]."""
STROKE: Final = {"revolute": math.pi, "prismatic": 0.5}
"""Range of a joint without limits [rad, m]."""
SPEED: Final = 0.3
ACCELERATION: Final = 0.5
"""Velocity and acceleration at which the regressor is evaluated [rad/s, rad/s^2]."""
SHARE: Final = 0.3
"""Fraction of a joint's range and of its velocity limit that the motion uses."""


Column = NDArray[np.float64]


@final
@dataclass(frozen=True)
class FirstGraph:
    """Text of a graph, the robot file that it needs next to it, and what was chosen and assumed."""

    text: str
    robot: Mapping[str, str]
    notes: tuple[str, ...]


def is_robot(name: str) -> bool:
    """True for the name of a packaged robot, or a file of a robot."""
    return name.lower().endswith(ROBOT_FILES) or name in robots()


def first_graph(
    name: str,
    folder: Path,
    tool: str | None = None,
    hold: Mapping[str, float] | None = None,
    *,
    axes: tuple[int, int] = AXES,
    stem: str = "",
) -> FirstGraph:
    """A graph with which a robot runs and verifies.

    Parameters
    ----------
    name : a packaged robot, or the path of a URDF, xacro or MJCF file
    folder : where the graph will be
    tool : frame at the end of the arm; by default the flange
    hold : joints between the base and the tool that do not move, with their positions [rad, m]
    axes : least and largest number of moving joints of a robot file
    stem : name of the graph's file without ending, after which a changed robot file is named; default: that of `name`

    Raises
    ------
    MissingError, RobotError, UnknownNameError
        The file cannot be read, or the robot is not an arm of so many axes.
    """
    hold = dict(hold or {})
    if not name.lower().endswith(ROBOT_FILES):
        chain = load(name, tool=tool, hold=hold)
        return FirstGraph(_text(chain, name, tool, hold, {}), {}, ())
    path = Path(name).expanduser()
    where = f"robot {path.name}"
    file = read_any(path)
    for fault in faults_of_tree(file.root, file.lines, where):
        raise RobotError(fault)
    frame = tool or flange_of(file.root, where)
    _check_axes(file.root, frame, hold, where, axes)
    before = ElementTree.tostring(file.root)
    notes = repaired(file.root, frame, where)
    changed = file.converted or ElementTree.tostring(file.root) != before
    original = path.name.partition(".")[0]
    urdf_name = f"{original}.urdf"
    if not changed:
        text, model, chain = None, os.path.relpath(path, folder), load(str(path), tool=frame, hold=hold)
    else:
        text = written(file.root, notes)
        if stem not in ("", original) or (folder / urdf_name).resolve() == path.resolve():
            urdf_name = f"{stem or path.stem}_arm.urdf"
        model = urdf_name
        check_parts(file.root, file.lines, where, hold=hold, tool=frame)  # with the lines of the user's file
        with tempfile.TemporaryDirectory() as place:
            made = Path(place) / f"{original}.urdf"  # the name of the robot, and of its file in messages
            made.write_text(text, encoding="utf-8")
            chain = load(str(made), tool=frame, hold=hold)
    rotor = {joint: value for joint, value in file.armature.items() if joint in chain.joint_names}
    said = [f"tool: {frame}"] if tool is None else []
    said += _still(file.root, chain, hold)
    said += [*_unused(file.root, frame), *impossible_inertias(file.root, frame), *implausible_values(file.root, frame)]
    if rotor:
        said.append("the armature of the MJCF file is the rotor inertia of the graph's arm")
    return FirstGraph(
        _text(chain, model, frame, hold, rotor, notes), {} if text is None else {urdf_name: text}, (*said, *notes)
    )


def _still(root: Element, chain: SerialChain, hold: Mapping[str, float]) -> list[str]:
    """That joints outside of the arm, such as those of a gripper, do not move."""
    names = [
        joint.get("name", "")
        for joint in root.findall("joint")
        if joint.get("type") in MOVING and joint.get("name") not in {*chain.joint_names, *hold}
    ]
    return [f"held at 0, since they are not between base and tool: {listed(names)}"] if names else []


def _unused(root: Element, frame: str) -> list[str]:
    """That an arm ends before a joint that is neither turning nor sliding."""
    return [
        f"joint {joint.get('name', '')} of type {joint.get('type', '')} is not part of the arm: expected revolute, "
        "continuous or prismatic"
        for joint in root.findall("joint")
        if joint.get("type") not in (*MOVING, "fixed") and joint not in joints_to(root, frame)
    ]


def _check_axes(root: Element, frame: str, hold: Mapping[str, float], where: str, axes: tuple[int, int]) -> None:
    """Refuse a tool whose arm has too few or too many axes."""
    if frame not in {link.get("name") for link in root.iter("link")}:
        return  # reported with the names of the frames when the robot is read
    moving = [
        joint.get("name", "")
        for joint in joints_to(root, frame)
        if joint.get("type") in MOVING and joint.find("mimic") is None and joint.get("name") not in hold
    ]
    least, most = axes
    if least <= len(moving) <= most:
        return
    listed = f" ({', '.join(moving)})" if moving else ""
    some = "hold some with --hold JOINT=POSITION, or " if len(moving) > most else ""
    raise RobotError(
        f"{where}: {len(moving)} joints move on the way to {frame}{listed}; expected an arm with {least} to {most}: "
        f"{some}name another frame with --tool, or write a graph with free and hold"
    )


def _text(
    chain: SerialChain,
    model: str,
    tool: str | None,
    hold: Mapping[str, float],
    armature: Mapping[str, float],
    notes: list[str] | None = None,
) -> str:
    """The graph as YAML."""
    source = find_robot(model).description if model in robots() else chain.name
    centre, links, weight, rows = _sampled(chain)
    rotor = _rotors(chain, links, armature)
    inertia = links + rotor
    K_D = np.maximum(RATE * inertia, weight / (RATIO_P * np.array([SAG[joint.kind] for joint in chain.joints])))
    viscous = np.minimum(VISCOUS * K_D, MOST_VISCOUS * _efforts(chain))
    coulomb = np.minimum(COULOMB * K_D, MOST_COULOMB * _efforts(chain))
    # a sample changes the command by w Y Gamma Y' sigma and by Lambda tau^2 sigma, times the period
    Gamma = STEP / PERIOD / np.max(rows / K_D)
    Lambda = STEP / PERIOD / np.maximum(weight + inertia, 1e-2 * weight.max()) ** 2
    amplitude = np.array([float(_number(_amplitude(joint))) for joint in chain.joints])
    rate = 1.0 + 0.8 * np.arange(chain.n) / max(1, chain.n - 1)
    limits = np.array([joint.velocity for joint in chain.joints])
    slow = min(1.0, float(np.min(SHARE * limits / np.maximum(amplitude * rate, 1e-9))))
    box = f"[{_list(np.zeros(chain.n))}, {_list(3.2 / K_D)}]"
    keys = {"model": model, "tool": tool, "hold": _table(hold)}
    section = ", ".join(f"{key}: {value}" for key, value in keys.items() if value)
    robot = f"robot: {{{section}}}" if tool or hold else f"robot: {model}"
    comments = "".join(f"# Assumed: {note}\n" for note in notes or [])
    return f"""dmframe: 1
title: {chain.name} tracks a joint path through a PID position servo
{comments}{robot}   # {source}
clock: {1000 * PERIOD:g} ms
duration: 30 s
start: {{q: [{", ".join(f"{q:.6g}" for q in centre + amplitude)}]}}   # on the path, which begins at rest
blocks:
  # The centre is inside the limits and away from singular postures.
  path:     {{type: sinusoid, center: {_list(centre)}, amplitude: {_list(amplitude)}, rate: {_list(slow * rate)},
             phase: 1.570796}}
  task:     {{type: joint_tracking, alpha_bar: 3}}
  model:    {{type: regressor, friction: [viscous, coulomb], rotors: true}}
  # Each gain changes the commands by {100 * STEP:g} % of the error in one sample, at most.
  dynamics: {{type: dynamic_compensator, Gamma: {_number(Gamma)}}}
  # Initially w is half its true value, 1/K_D; w_P and w_I are within 10 % of theirs, K_P/K_D and K_I/K_D.
  inverse:  {{type: pid_inverse, K_c: 2, Lambda: {_list(Lambda)}, Lambda_P: 1, Lambda_I: 1,
             w: {_list(0.5 / K_D)}, w_P: 2, w_I: 0.7, w_box: {box}, w_P_box: [1, 3], w_I_box: [0.5, 2]}}
  # Placeholders, hidden from the controller: manufacturers do not publish them.
  servo:    {{type: pid_servo, K_D: {_list(K_D)}, K_P: {_list(RATIO_P * K_D)}, K_I: {_list(RATIO_I * K_D)}}}
  arm:      {{type: manipulator, viscous: {_list(viscous)}, coulomb: {_list(coulomb)},
             rotor: {_list(rotor)}}}
# The same feedback gain without adaptation. Neither law is tuned; `dmframe design` compares tuned ones.
baseline:
  inverse: {{type: kinematic_command}}
  model: null
  dynamics: null
"""


def _rotors(chain: SerialChain, links: Column, armature: Mapping[str, float]) -> Column:
    """Rotor inertias: those of the file, else placeholders from the inertia of the links."""
    relative, least = ROTOR
    largest = {
        kind: max((value for joint, value in zip(chain.joints, links, strict=True) if joint.kind == kind), default=0.0)
        for kind in REACH
    }
    return np.array(
        [
            armature.get(joint.name) or max(relative * value, least * largest[joint.kind])
            for joint, value in zip(chain.joints, links, strict=True)
        ]
    )


def _table(hold: Mapping[str, float]) -> str:
    return f"{{{', '.join(f'{joint}: {_number(value)}' for joint, value in hold.items())}}}" if hold else ""


def _amplitude(joint: Joint) -> float:
    return min(REACH[joint.kind], max(0.0, SHARE * (joint.upper - joint.lower) / 2))


def _sampled(chain: SerialChain) -> tuple[Column, Column, Column, Column]:
    """Posture with the best dexterity times distance to the limits times reserve of torque, and of each joint the
    largest inertia, the largest gravity torque, and the largest squared norm of its row of the regressor.

    Dexterity is the least singular value of the tool's Jacobian, of its position if there are fewer than six joints,
    with lengths relative to the largest.
    """
    import pinocchio as pin

    random, data = np.random.default_rng(0), chain.model.createData()
    ends = [_range(joint) for joint in chain.joints]
    lower, upper = np.array(ends).T
    efforts = _efforts(chain)
    room = np.array([_amplitude(joint) for joint in chain.joints]) + 1e-3  # of the motion and of rounding
    best, found = -1.0, (lower + upper) / 2
    inertia, torque, rows = np.zeros((3, chain.n))
    for q in (found, *random.uniform(lower, upper, (SAMPLES, chain.n))):
        configuration = pin_configuration(chain, q)
        pin.crba(chain.model, data, configuration)
        inertia = np.maximum(inertia, np.diag(data.M))
        weight = np.abs(pin.computeGeneralizedGravity(chain.model, data, configuration))
        torque = np.maximum(torque, weight)
        motion = np.full(chain.n, SPEED), np.full(chain.n, ACCELERATION)
        # Pinocchio drops the axis of a single joint
        regressor = pin.computeJointTorqueRegressor(chain.model, data, configuration, *motion).reshape(chain.n, -1)
        # the columns of a rotor and of viscous and Coulomb friction have one element each
        rows = np.maximum(rows, np.sum(regressor**2, axis=1) + ACCELERATION**2 + SPEED**2 + 1)
        jacobian = pin.computeFrameJacobian(
            chain.model, data, configuration, chain.model_tool, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        ).reshape(6, -1)[:3]
        values = np.linalg.svd(jacobian, compute_uv=False)
        margin = np.min(np.minimum(q - lower, upper - q) / np.maximum(upper - lower, 1e-9))
        reserve = min(1.0, EFFORT / max(float(np.max(weight / efforts)), 1e-9)) ** 2
        score = values[min(chain.n, 3) - 1] / max(values[0], 1e-9) * min(1.0, 4 * margin) * reserve
        if score > best and np.all(np.minimum(q - lower, upper - q) >= room):
            best, found = score, q
    return np.round(found, 3), inertia, torque, rows


def _efforts(chain: SerialChain) -> Column:
    """Torque limits [N m, N]; infinite if there are none."""
    return np.array([joint.effort if joint.effort > 0 else np.inf for joint in chain.joints])


def _range(joint: Joint) -> tuple[float, float]:
    """Range of a joint from which postures are drawn: its limits, or a part of it about 0."""
    stroke = STROKE[joint.kind]
    lower, upper = max(joint.lower, -stroke), min(joint.upper, stroke)
    return (lower, upper) if lower <= upper else (joint.lower, joint.upper)


def _list(values: object) -> str:
    return f"[{', '.join(map(_number, np.asarray(values, dtype=float)))}]"


def _number(value: float) -> str:
    return f"{value:.4g}"
