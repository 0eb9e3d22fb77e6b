"""First graph of a robot: an adaptive law in joint space with gains from the robot's own inertia.

The servo that the simulated robot hides is a placeholder, a PID servo of positions. Its gains scale with the largest
inertia of each joint, as do those of the law, so that the loop's rates are the same for a small and a large robot.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from dmframe.common.errors import RobotError
from dmframe.robot.chain import Joint, SerialChain, pin_configuration
from dmframe.robot.convert import FORMATS, joints_to, read_any, written
from dmframe.robot.flange import MOVING, flange_of, repaired
from dmframe.robot.library import find_robot, load, robots

AXES: Final = (4, 7)
"""Least and most moving joints of an arm."""
RATE: Final = 80.0
"""Bandwidth of the servo's velocity loop at the largest inertia of a joint [rad/s]."""
SPREAD: Final = 0.02
"""Least gain of a joint relative to the largest."""
PERIOD: Final = 0.008
"""Sampling period [s]."""
STEP: Final = 0.05
"""Fraction of an error that adaptation may remove within one sample; from 2 on it diverges."""
SAMPLES: Final = 400
"""Postures tried for the centre of the motion."""
REACH: Final = {"revolute": 0.25, "prismatic": 0.05}
"""Largest amplitude [rad, m]."""
SPEED: Final = 0.3
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
    return name.lower().endswith(FORMATS) or name in robots()


def first_graph(name: str, folder: Path, tool: str | None = None) -> FirstGraph:
    """A graph with which a robot runs and verifies.

    Parameters
    ----------
    name : a packaged robot, or the path of a URDF, xacro or MJCF file
    folder : where the graph will be
    tool : frame at the end of the arm; by default the flange

    Raises
    ------
    MissingError, RobotError, UnknownNameError
        The file cannot be read, or the robot is not an arm of 4 to 7 axes.
    """
    if not name.lower().endswith(FORMATS):
        chain = load(name, tool=tool)
        return FirstGraph(_text(chain, name, tool, {}), {}, ())
    path = Path(name).expanduser()
    where = f"robot {path.name}"
    file = read_any(path)
    frame = tool or flange_of(file.root, where)
    moving = sum(joint.get("type") in MOVING and joint.find("mimic") is None for joint in joints_to(file.root, frame))
    if frame in {link.get("name") for link in file.root.iter("link")} and not AXES[0] <= moving <= AXES[1]:
        raise RobotError(
            f"{where}: {moving} joints move on the way to {frame}; expected an arm with {AXES[0]} to {AXES[1]}: name "
            "another frame with --tool, or write a graph with free and hold"
        )
    notes = repaired(file.root, frame, where)
    text = written(file.root, notes) if file.converted or notes else None
    urdf_name = f"{path.name.partition('.')[0]}.urdf"
    if text is None:
        model, chain = os.path.relpath(path, folder), load(str(path), tool=frame)
    else:
        if (folder / urdf_name).resolve() == path.resolve():
            urdf_name = f"{path.stem}_arm.urdf"
        model = urdf_name
        with tempfile.TemporaryDirectory() as place:
            made = Path(place) / urdf_name
            made.write_text(text, encoding="utf-8")
            chain = load(str(made), tool=frame)
    rotor = {joint: value for joint, value in file.armature.items() if joint in chain.joint_names}
    remarks = [f"tool: {frame}"] if tool is None else []
    if rotor:
        remarks.append("the armature of the MJCF file is the rotor inertia of the graph's arm")
    return FirstGraph(
        _text(chain, model, frame, rotor, notes), {} if text is None else {urdf_name: text}, (*remarks, *notes)
    )


def _text(
    chain: SerialChain, model: str, tool: str | None, rotor: Mapping[str, float], notes: list[str] | None = None
) -> str:
    """The graph as YAML."""
    source = find_robot(model).description if model in robots() else chain.name
    centre, inertia, torque, rows = _sampled(chain)
    inertia = inertia + np.array([rotor.get(joint, 0.0) for joint in chain.joint_names])
    K_D = np.maximum(RATE * inertia, SPREAD * RATE * inertia.max())
    # a sample changes the command by w Y Gamma Y' sigma and by Lambda tau^2 sigma, times the period
    Gamma = STEP / PERIOD / np.max(rows / K_D)
    Lambda = STEP / PERIOD / np.maximum(torque + inertia, 1e-2 * torque.max()) ** 2
    amplitude = np.array([_amplitude(joint) for joint in chain.joints])
    rate = 0.5 + 0.4 * np.arange(chain.n) / max(1, chain.n - 1)
    slow = min(
        [1.0, *(SHARE * joint.velocity / (a * w) for joint, a, w in zip(chain.joints, amplitude, rate, strict=True))]
    )
    rotor_value = f", rotor: {_list([rotor.get(joint, 0.0) for joint in chain.joint_names])}" if rotor else ""
    box = f"[{_list(np.zeros(chain.n))}, {_list(3.2 / K_D)}]"
    robot = f"robot: {{model: {model}, tool: {tool}}}" if tool else f"robot: {model}"
    comments = "".join(f"# Assumed: {note}\n" for note in notes or [])
    return f"""dmframe: 1
title: {chain.name} tracks a joint path through a PID position servo
{comments}{robot}   # {source}
clock: {1000 * PERIOD:g} ms
duration: 30 s
start: {{q: {_list(centre)}}}   # inside the limits and away from singular postures
blocks:
  path:     {{type: sinusoid, center: {_list(centre)}, amplitude: {_list(amplitude)}, rate: {_list(slow * rate)}}}
  task:     {{type: joint_tracking, alpha_bar: 2}}
  model:    {{type: regressor, friction: [viscous]{", rotors: true" if rotor else ""}}}
  # Each gain changes the commands by 5 % of the error in one sample, at most.
  dynamics: {{type: dynamic_compensator, Gamma: {_number(Gamma)}}}
  inverse:  {{type: pid_inverse, K_c: 1, Lambda: {_list(Lambda)}, Lambda_P: 1, Lambda_I: 1,
             w_P: 2, w_I: 0.7, w_box: {box}, w_P_box: [1, 3], w_I_box: [0.5, 2]}}
  # Placeholders, hidden from the controller: the maker does not publish the servo, and the file has no friction.
  servo:    {{type: pid_servo, K_D: {_list(K_D)}, K_P: {_list(2.2 * K_D)}, K_I: {_list(0.7 * K_D)}}}
  arm:      {{type: manipulator, viscous: {_list(K_D / 160)}{rotor_value}}}
baseline:
  inverse: {{type: kinematic_command}}
  model: null
  dynamics: null
"""


def _amplitude(joint: Joint) -> float:
    return min(REACH[joint.kind], SHARE * (joint.upper - joint.lower) / 2)


def _sampled(chain: SerialChain) -> tuple[Column, Column, Column, Column]:
    """Posture with the best dexterity times distance to the limits, and of each joint the largest inertia, the largest
    gravity torque, and the largest squared norm of its row of the regressor.

    Dexterity is the least singular value of the tool's Jacobian, of its position if there are fewer than six joints,
    with lengths relative to the largest.
    """
    import pinocchio as pin

    random, data = np.random.default_rng(0), chain.model.createData()
    ends = [(max(joint.lower, -math.pi), min(joint.upper, math.pi)) for joint in chain.joints]
    lower, upper = np.array(ends).T
    best, found = -1.0, (lower + upper) / 2
    inertia, torque, rows = np.zeros((3, chain.n))
    for q in (found, *random.uniform(lower, upper, (SAMPLES, chain.n))):
        configuration = pin_configuration(chain, q)
        pin.crba(chain.model, data, configuration)
        inertia = np.maximum(inertia, np.diag(data.M))
        torque = np.maximum(torque, np.abs(pin.computeGeneralizedGravity(chain.model, data, configuration)))
        slow = np.full(chain.n, SPEED)
        regressor = pin.computeJointTorqueRegressor(chain.model, data, configuration, slow, slow)
        rows = np.maximum(rows, np.sum(regressor**2, axis=1))
        jacobian = pin.computeFrameJacobian(
            chain.model, data, configuration, chain.model_tool, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )[:3]
        values = np.linalg.svd(jacobian, compute_uv=False)
        margin = np.min(np.minimum(q - lower, upper - q) / np.maximum(upper - lower, 1e-9))
        score = values[min(chain.n, 3) - 1] / max(values[0], 1e-9) * min(1.0, 4 * margin)
        if score > best:
            best, found = score, q
    return np.round(found, 3), inertia, torque, rows


def _list(values: object) -> str:
    return f"[{', '.join(map(_number, np.asarray(values, dtype=float)))}]"


def _number(value: float) -> str:
    return f"{value:.4g}"
