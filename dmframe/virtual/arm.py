"""Kinematics of a UR's six joints; the graph may fix some of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from dmframe.common.errors import EngineError, RobotError, listed
from dmframe.config import BaseGraph
from dmframe.robot.chain import SerialChain, pin_configuration
from dmframe.robot.library import find_robot
from dmframe.runtime.ur_arm import JOINTS

BASE: Final = ("base",)
"""Frame of a UR's poses, which is rotated by pi against the URDF's base_link."""
FLANGE: Final = ("tool0", "ee_link")
TOLERANCE: Final = 1e-3
"""Commanded speed of a held joint above which the robot stops [rad/s]."""
NEAR: Final = 1e-9
"""Tolerance of the inverse kinematics [m and rad]."""
MOST_STEPS: Final = 100


@final
@dataclass(frozen=True)
class Arm:
    """A UR with six joints, as in the interface for clients.

    Parameters
    ----------
    name
        Name of the robot.
    chain
        The graph's chain; its joints are some or all of the six, in their order.
    places
        Index among the six of each joint of the chain.
    held : (6,), rad
        Angles of the held joints; 0 for those that move.
    lower, upper, velocity : (6,), rad and rad/s
        The URDF's limits; infinite for held joints.
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
        """True if all six joints move."""
        return len(self.places) == len(JOINTS)

    @property
    def still(self) -> list[int]:
        """Indices of the held joints."""
        return [k for k in range(len(JOINTS)) if k not in self.places]

    def six(self, values: np.ndarray, rest: np.ndarray | float = 0.0) -> np.ndarray:
        """Values of the chain's joints extended to the six, with `rest` for the others."""
        found = np.zeros(len(JOINTS)) + rest
        found[list(self.places)] = values
        return found

    def refused(self, speed: np.ndarray, ahead: np.ndarray) -> str:
        """Reason for which target speeds, which lead to the angles `ahead`, stop the robot; empty if there is none."""
        if not np.isfinite(speed).all():
            return "a target speed is not a number"
        for k, joint in enumerate(JOINTS):
            if k not in self.places:
                if abs(speed[k]) > TOLERANCE:
                    return f"{joint} is commanded to move, but the graph holds it"
            elif abs(speed[k]) > self.velocity[k] * (1 + 1e-9):
                return f"{joint}: commanded speed {speed[k]:.4g} rad/s exceeds its limit {self.velocity[k]:.4g} rad/s"
            elif (ahead[k] > self.upper[k] and speed[k] > 0) or (ahead[k] < self.lower[k] and speed[k] < 0):
                return f"{joint}: commanded angle {ahead[k]:.4g} rad is outside its limits"
        return ""

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Flange pose at six angles [rad], in the UR's base frame: position [m], rotation vector [rad]."""
        import pinocchio as pin

        at = self._placed(q)
        return np.concatenate([at.translation, pin.log3(at.rotation)])

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Jacobian (6, 6) of the flange's velocity and angular velocity, in the axes of the UR's base."""
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

    def inverse(
        self, pose: np.ndarray, near: np.ndarray, steps: int = MOST_STEPS, spend: Callable[[], None] = lambda: None
    ) -> np.ndarray:
        """Joint angles of a flange pose, by damped least squares from the angles `near`; `spend` is called each step.

        Raises
        ------
        EngineError
            Some joints are held, or the iteration did not converge.
        """
        import pinocchio as pin

        if not self.whole:
            raise EngineError(f"inverse kinematics: {self.name} has only {len(self.places)} free joints in this graph")
        goal, q = pin.SE3(pin.exp3(pose[3:]), pose[:3]), near.copy()
        for _ in range(steps):
            spend()
            at = self._placed(q)
            error = np.concatenate(
                [goal.translation - at.translation, at.rotation @ pin.log3(at.rotation.T @ goal.rotation)]
            )
            if np.max(np.abs(error)) < NEAR:
                return q
            J = self.jacobian(q)
            size = min(1.0, 0.5 / max(np.max(np.abs(error)), 1e-12))
            q = q + J.T @ np.linalg.solve(J @ J.T + 1e-10 * np.eye(6), size * error)
        raise EngineError("inverse kinematics: no angles were found for this pose from the current configuration")

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


def arm_of(graph: BaseGraph) -> Arm:
    """The UR of a graph.

    Raises
    ------
    RobotError
        The graph has no robot, or its robot is not a UR: its joints have other names, or another order.
    """
    chain, section = graph.robot, graph.file.robot
    if chain is None or section is None:
        raise RobotError(f"{graph.name}: expected a graph with a UR robot, found one without a robot")
    strange = [name for name in chain.joint_names if name not in JOINTS]
    if strange:
        raise RobotError(
            f"{graph.name}: expected a UR, whose joints are {listed(JOINTS)}; robot {chain.name} has "
            f"{listed(strange)}; a virtual robot emulates URs only"
        )
    places = tuple(map(JOINTS.index, chain.joint_names))
    source = find_robot(section.model, Path(graph.document.name).parent)
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
