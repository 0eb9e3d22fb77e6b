"""Joint positions along a path of the tool."""

from __future__ import annotations

from typing import Final, final

import numpy as np

from dmframe.common.errors import RobotError
from dmframe.design.path_file import Array
from dmframe.robot.chain import SerialChain, pin_configuration

STARTS: Final = 40
"""Postures from which the inverse kinematics start."""
ITERATIONS: Final = 60
REACHED: Final = 1e-6
"""Largest remaining error of a pose [m]."""
SINGULAR: Final = 0.02
"""Smallest ratio of the singular values of J on a path."""
STEP: Final = 0.3
"""Largest change of a joint by an iteration [rad, m]."""
STROKE: Final = 3.2
"""Range of a joint without limits [rad, m]."""


@final
class Kinematics:
    """Forward and inverse kinematics of an arm.

    Parameters
    ----------
    turns
        Whether the orientation of the tool is prescribed.

    Raises
    ------
    RobotError
        The arm has too few joints.
    """

    def __init__(self, chain: SerialChain, *, turns: bool) -> None:
        least, what = (6, "position and orientation") if turns else (3, "position")
        if chain.n < least:
            raise RobotError(
                f"expected an arm with at least {least} joints for a path of the tool's {what}, found {chain.n}; take "
                f"--task {'position' if turns else 'joints'}"
            )
        self.chain, self.turns = chain, turns
        self._data = chain.model.createData()
        ends = [(max(joint.lower, -STROKE), min(joint.upper, STROKE)) for joint in chain.joints]
        self.lower, self.upper = np.array(ends).T
        _, J = self._at(np.clip(0.5 * (self.lower + self.upper), self.lower, self.upper))
        self.lever = max(float(np.linalg.norm(J[:3])) / max(float(np.linalg.norm(J[3:])), 1e-9), 1e-3)

    def _at(self, q: Array) -> tuple[object, Array]:
        """Placement of the tool, and its Jacobian (6, n) along the axes of the base."""
        import pinocchio as pin

        configuration = pin_configuration(self.chain, q)
        J = pin.computeFrameJacobian(
            self.chain.model,
            self._data,
            configuration,
            self.chain.model_tool,
            pin.ReferenceFrame.LOCAL_WORLD_ALIGNED,
        )
        pin.updateFramePlacement(self.chain.model, self._data, self.chain.model_tool)
        return self._data.oMf[self.chain.model_tool], J

    def pose(self, q: Array) -> Array:
        """Position [m] and rotation vector [rad] of the tool, (6,)."""
        import pinocchio as pin

        placement, _ = self._at(q)
        return np.concatenate([placement.translation, pin.log3(placement.rotation)])  # type: ignore[attr-defined]

    def _error(self, q: Array, goal: Array) -> tuple[Array, Array]:
        """Error of the pose and its Jacobian, with rotations times a length."""
        import pinocchio as pin

        placement, J = self._at(q)
        e = goal[:3] - placement.translation  # type: ignore[attr-defined]
        if not self.turns:
            return e, J[:3]
        turn = pin.log3(pin.exp3(np.asarray(goal[3:])) @ placement.rotation.T)  # type: ignore[attr-defined]
        return np.concatenate([e, self.lever * turn]), np.vstack([J[:3], self.lever * J[3:]])

    def solve(self, goal: Array, q: Array, rest: Array) -> Array | None:
        """Joint positions at a pose near q, nearest to `rest` if the robot is redundant; None if none is found."""
        spare = self.chain.n > len(self._error(q, goal)[0])
        for _ in range(ITERATIONS):
            e, J = self._error(q, goal)
            damped = J @ J.T + 1e-10 * np.eye(len(e))
            step = J.T @ np.linalg.solve(damped, e)
            if spare:
                step += (rest - q) - J.T @ np.linalg.solve(damped, J @ (rest - q))
            size = float(np.max(np.abs(step)))
            if np.linalg.norm(e) < REACHED and size < 1e-6:
                return q
            q = q + step * min(1.0, STEP / max(size, 1e-12))
        return q if np.linalg.norm(self._error(q, goal)[0]) < REACHED else None

    def along(self, goals: Array, q: Array, rest: Array) -> tuple[Array | None, str]:
        """Joint positions along a path from q; None with the reason if it leaves the reach or the limits."""
        found = list[Array]()
        for k, goal in enumerate(goals):
            solved = self.solve(goal, q, rest)
            if solved is None:
                return None, f"point {k + 1} is out of reach, or on the other side of a singular posture"
            J = self._error(solved, goal)[1]
            values = np.linalg.svd(J, compute_uv=False)
            if values[-1] < SINGULAR * values[0]:
                return None, f"the posture at point {k + 1} is singular"
            wrong = (solved < self.lower - 1e-9) | (solved > self.upper + 1e-9)
            if np.any(wrong):
                joint = self.chain.joint_names[int(np.argmax(wrong))]
                return None, f"{joint} leaves its range at point {k + 1}"
            if found and np.max(np.abs(solved - found[-1])) > STEP:
                return None, f"the joints jump at point {k + 1}"
            found.append(solved)
            q = solved
        return np.array(found), ""


def followed(kinematics: Kinematics, goals: Array, near: Array) -> Array:
    """Joint positions (N, n) along poses of the tool, from the start nearest to a posture.

    Raises
    ------
    RobotError
        The path cannot be followed within the range of the joints.
    """
    random, reasons, solutions = np.random.default_rng(0), dict[str, int](), list[Array]()
    starts = [near, *random.uniform(kinematics.lower, kinematics.upper, (STARTS, kinematics.chain.n))]
    for start in starts:
        rest = np.clip(start, kinematics.lower, kinematics.upper)
        first = kinematics.solve(goals[0], rest, rest)
        if first is None:
            reasons["point 1 is out of reach"] = reasons.get("point 1 is out of reach", 0) + 1
            continue
        wrapped = _within(first, kinematics)
        if any(np.max(np.abs(wrapped - other)) < 1e-3 for other in solutions):
            continue
        solutions.append(wrapped)
        found, why = kinematics.along(goals, wrapped, wrapped)
        if found is not None:
            return found
        reasons[why] = reasons.get(why, 0) + 1
    why = max(reasons, key=lambda reason: (reason != "point 1 is out of reach", reasons[reason]))
    raise RobotError(f"the robot cannot follow the path of the tool: {why}")


def _within(q: Array, kinematics: Kinematics) -> Array:
    """The same posture with revolute joints turned by whole turns into their range."""
    turns = np.array([joint.kind == "revolute" for joint in kinematics.chain.joints])
    middle = 0.5 * (kinematics.lower + kinematics.upper)
    return np.where(turns, q - 2 * np.pi * np.round((q - middle) / (2 * np.pi)), q)
