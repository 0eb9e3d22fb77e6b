"""The six joints of a UR, of which a graph may leave some held, and where its flange is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from dmframe.config.experiment import Experiment
from dmframe.errors import EngineError, RobotError, listed
from dmframe.robot.chain import SerialChain, pin_configuration
from dmframe.robot.library import find_robot

JOINTS: Final = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
BASE: Final = ("base",)
"""A UR tells poses in this frame, which is turned by pi against the URDF's base_link."""
FLANGE: Final = ("tool0", "ee_link")
TOLERANCE: Final = 1e-3
"""Faster than this a joint that is held is told to move [rad/s]."""
NEAR: Final = 1e-9
"""Of an inverse kinematics: metres and radians."""
MOST_STEPS: Final = 100


@final
@dataclass(frozen=True)
class Arm:
    """A UR as a client sees it: always six joints.

    Parameters
    ----------
    name
        The robot's.
    chain
        The graph's own; its joints are some or all of the six, in their order.
    places
        Where each joint of the chain stands among the six.
    held : (6,), rad
        Where the others are held; 0 for those that move.
    lower, upper, velocity : (6,), rad and rad/s
        The URDF's limits; those of held joints are not finite.
    """

    name: str
    chain: SerialChain
    places: tuple[int, ...]
    held: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray

    @property
    def whole(self) -> bool:
        """True where all six joints move."""
        return len(self.places) == len(JOINTS)

    @property
    def still(self) -> list[int]:
        """Which of the six are held."""
        return [k for k in range(len(JOINTS)) if k not in self.places]

    def six(self, values: np.ndarray, rest: np.ndarray | float = 0.0) -> np.ndarray:
        """Numbers of the chain's joints among the six, the others at `rest`."""
        found = np.zeros(len(JOINTS)) + rest
        found[list(self.places)] = values
        return found

    def refused(self, speed: np.ndarray, ahead: np.ndarray) -> str:
        """Why target speeds of the six stop the robot, which lead to the angles `ahead`; empty where they do not."""
        if not np.isfinite(speed).all():
            return "a target speed is not a number"
        for k, joint in enumerate(JOINTS):
            if k not in self.places:
                if abs(speed[k]) > TOLERANCE:
                    return f"{joint} is told to move, and the graph holds it"
            elif abs(speed[k]) > self.velocity[k] * (1 + 1e-9):
                return f"{joint} is told {speed[k]:.4g} rad/s, its limit is {self.velocity[k]:.4g} rad/s"
            elif (ahead[k] > self.upper[k] and speed[k] > 0) or (ahead[k] < self.lower[k] and speed[k] < 0):
                return f"{joint} is told to go to {ahead[k]:.4g} rad, outside of its limits"
        return ""

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Where the flange is at six angles [rad], in the frame of a UR's base: position [m], rotation vector [rad]."""
        import pinocchio as pin

        at = self._placed(q)
        return np.concatenate([at.translation, pin.log3(at.rotation)])

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """(6, 6): the flange's velocity and angular velocity along the axes of the UR's base, by joint velocities."""
        import pinocchio as pin

        model, data = self._model
        base, flange = self._frames
        found = pin.computeFrameJacobian(
            model, data, self._configuration(q), flange, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        pin.updateFramePlacements(model, data)
        turn = data.oMf[base].rotation.T
        six = np.zeros((6, len(JOINTS)))
        six[:, list(self.places)] = np.vstack([turn @ found[:3], turn @ found[3:]])
        return six

    def inverse(self, pose: np.ndarray, near: np.ndarray) -> np.ndarray:
        """Angles that bring the flange to a pose, found from others near by.

        Raises
        ------
        EngineError
            Some joints are held, or none were found.
        """
        import pinocchio as pin

        if not self.whole:
            raise EngineError(f"inverse kinematics: {self.name} of this graph has only {len(self.places)} free joints")
        goal, q = pin.SE3(pin.exp3(pose[3:]), pose[:3]), near.copy()
        for _ in range(MOST_STEPS):
            at = self._placed(q)
            error = np.concatenate(
                [goal.translation - at.translation, at.rotation @ pin.log3(at.rotation.T @ goal.rotation)]
            )
            if np.max(np.abs(error)) < NEAR:
                return q
            J = self.jacobian(q)
            size = min(1.0, 0.5 / max(np.max(np.abs(error)), 1e-12))
            q = q + J.T @ np.linalg.solve(J @ J.T + 1e-10 * np.eye(6), size * error)
        raise EngineError("inverse kinematics: no angles were found for this pose from where the robot is")

    def _placed(self, q: np.ndarray) -> Any:
        import pinocchio as pin

        model, data = self._model
        base, flange = self._frames
        pin.framesForwardKinematics(model, data, self._configuration(q))
        return data.oMf[base].actInv(data.oMf[flange])

    def _configuration(self, q: np.ndarray) -> np.ndarray:
        return pin_configuration(self.chain, q[list(self.places)])

    @cached_property
    def _model(self) -> tuple[Any, Any]:
        return self.chain.model, self.chain.model.createData()

    @cached_property
    def _frames(self) -> tuple[int, int]:
        model = self.chain.model
        base = next((model.getFrameId(name) for name in BASE if model.existFrame(name)), 0)
        flange = next((model.getFrameId(name) for name in FLANGE if model.existFrame(name)), self.chain.model_tool)
        return base, flange


def arm_of(experiment: Experiment) -> Arm:
    """The UR of a graph.

    Raises
    ------
    RobotError
        The graph has no robot, or one that is no UR: joints of other names, or in another order.
    """
    chain, section = experiment.robot, experiment.file.robot
    if chain is None or section is None:
        raise RobotError(f"{experiment.name}: expected a graph with a UR robot, found one without a robot")
    strange = [name for name in chain.joint_names if name not in JOINTS]
    if strange:
        raise RobotError(
            f"{experiment.name}: expected a UR, whose joints are {listed(JOINTS)}; robot {chain.name} has "
            f"{listed(strange)}; a virtual robot speaks the protocols of URs alone"
        )
    places = tuple(map(JOINTS.index, chain.joint_names))
    source = find_robot(section.model, Path(experiment.document.name).parent)
    angles: Mapping[str, float] = {**source.hold, **section.hold}
    still = [k for k in range(len(JOINTS)) if k not in places]
    held = np.array([angles.get(name, 0.0) if k in still else 0.0 for k, name in enumerate(JOINTS)])

    def limits(of: str, rest: float) -> np.ndarray:
        return np.array([getattr(chain.joints[places.index(k)], of) if k in places else rest for k in range(6)])

    return Arm(
        chain.name,
        chain,
        places,
        held,
        limits("lower", -math.inf),
        limits("upper", math.inf),
        limits("velocity", math.inf),
    )
