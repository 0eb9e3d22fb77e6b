"""Reduction of a robot model to the chain of free joints that a graph drives."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dmframe.common.errors import RobotError, UnknownNameError, ValueFault
from dmframe.robot.mimics import Mimic, with_mimics

TOOL_FRAME = "dmframe_tool"
MOST_DEGREES: Final = 720.0
"""Largest number outside of a joint's limits that may be meant in degrees."""
FARTHEST = 1e100
"""Tool coordinates from this size on overflow in products. [m]"""


def reduce_model(
    model: Any,
    name: str,
    *,
    free: Sequence[str] | None,
    hold: Mapping[str, float],
    tool: str | Sequence[float] | None,
    mimics: Mapping[str, Mimic],
) -> tuple[Any, int]:
    """Model with all joints locked except the free ones, and the index of its tool frame.

    Raises
    ------
    UnknownNameError, ValueFault, RobotError
        See :meth:`dmframe.robot.chain.SerialChain.from_model`.
    """
    import pinocchio as pin

    where = f"robot {name}"
    names = list(model.names)[1:]
    _check_names(where, names, free, hold)
    for joint in names:
        # Pinocchio's reduction crashes on a joint without a frame, which a hand-written model may have.
        if not model.existFrame(joint, pin.FrameType.JOINT):
            raise RobotError(
                f"{where}: joint {joint} has no frame in the model; call model.addJointFrame on it",
                path=("robot", "model"),
            )
    if isinstance(tool, str):
        _frame(model, tool, where)
    kept = set(free) if free is not None else _between_base_and_tool(model, where, tool) - set(hold)
    if not kept:
        raise RobotError(f"{where}: no free joint is left; hold fewer joints", path=("robot", "free"))
    _check_kinds(model, where, kept, hold, mimics)
    known = {joint: law for joint, law in mimics.items() if joint in names}
    hold = with_mimics(known, hold, kept, where)
    locked = [model.getJointId(joint) for joint in names if joint not in kept]
    reduced = pin.buildReducedModel(_with_unique_frames(model), locked, model_configuration(model, hold))
    for frame in reduced.frames:
        frame.name = frame.name.removesuffix(_BODY)
    _check_chain(reduced, where)
    return reduced, _tool_frame(reduced, tool, where)


def _check_names(where: str, names: Sequence[str], free: Sequence[str] | None, hold: Mapping[str, float]) -> None:
    for key, given in (("free", list(free or ())), ("hold", list(hold))):
        for joint in given:
            if joint not in names:
                raise UnknownNameError(f"{where}: {key}: {joint}", "joint", joint, names, path=("robot", key))
            if given.count(joint) > 1:
                raise ValueFault(f"{where}: free names joint {joint} twice", path=("robot", "free"))
    for joint, angle in hold.items():
        if free is not None and joint in free:
            raise RobotError(f"{where}: joint {joint} is both free and held; choose one", path=("robot", "hold"))
        if not math.isfinite(angle):
            raise ValueFault(
                f"{where}: expected a finite angle to hold {joint} at, found {angle}", path=("robot", "hold")
            )


def _check_kinds(
    model: Any, where: str, kept: set[str], hold: Mapping[str, float], mimics: Mapping[str, Mimic]
) -> None:
    for index in range(1, model.njoints):
        joint, name = model.joints[index], model.names[index]
        if name not in kept and name not in hold:
            continue
        kind = joint.shortname().removeprefix("JointModel")
        kind = {"FreeFlyer": "floating", "Planar": "planar"}.get(kind, kind)  # as a URDF calls it
        if name in kept and (name in mimics or kind.startswith("Mimic")):
            raise RobotError(
                f"{where}: joint {name} mimics another joint; it can be held, not free", path=("robot", "free")
            )
        if joint.nv != 1:
            use = "a free joint to be" if name in kept else "a held joint to be"
            raise RobotError(
                f"{where}: joint {name} is of type {kind}; expected {use} revolute or prismatic; if it does not move "
                "in use, make it fixed in the robot's file",
                path=("robot", "free" if name in kept else "hold"),
            )
        subspace = motion_subspace(joint)
        if name in hold:
            unit = "rad" if np.any(subspace[3:]) else "m"
            _check_unit(where, name, hold[name], unit)
            if joint.nq == 1:  # a continuous joint has two coordinates and no limits
                place = joint.idx_q
                _check_range(
                    where, name, hold[name], (model.lowerPositionLimit[place], model.upperPositionLimit[place]), unit
                )
        if name in kept and np.any(subspace[:3]) and np.any(subspace[3:]):
            raise RobotError(
                f"{where}: joint {name} is of type {kind}; expected a free joint to be revolute or prismatic; "
                "if it does not move in use, make it fixed in the robot's file",
                path=("robot", "free"),
            )
        if name in kept and model.armature[joint.idx_v] != 0:
            raise RobotError(
                f"{where}: joint {name} has an armature; expected none: set rotor of the plant, as in `manipulator`",
                path=("robot", "model"),
            )


def _check_unit(where: str, name: str, value: float, unit: str) -> None:
    """Check that a prismatic joint has a length and a revolute one an angle; a plain number has no unit."""
    if getattr(value, "unit", unit) != unit:
        kind = "prismatic: expected a length, as 0.1 m" if unit == "m" else "revolute: expected an angle, as 30 deg"
        raise ValueFault(
            f"{where}: hold: joint {name} is {kind}; found {float(value):.6g} {getattr(value, 'unit', '')}",
            path=("robot", "hold", name),
        )


def _check_range(where: str, name: str, value: float, limits: tuple[float, float], unit: str) -> None:
    """Check that a joint is held inside of its limits, outside of which a number in degrees is."""
    low, high = limits
    room = 1e-6 * (high - low)
    if low - room <= value <= high + room or not low < high:
        return
    degrees = f"; for degrees write {float(value):.6g} deg" if unit == "rad" and abs(value) <= MOST_DEGREES else ""
    raise ValueFault(
        f"{where}: hold: joint {name}: expected a position from {low:.6g} to {high:.6g} {unit}, its limits, found "
        f"{float(value):.6g} {unit}{degrees}",
        path=("robot", "hold", name),
    )


def _between_base_and_tool(model: Any, where: str, tool: str | Sequence[float] | None) -> set[str]:
    """Joints between the base and the tool's frame, or of the only chain."""
    if isinstance(tool, str):
        index = model.frames[_frame(model, tool, where)].parentJoint
    else:
        leaves = [i for i in range(1, model.njoints) if i not in set(model.parents)]
        if len(leaves) > 1:
            ends = ", ".join(model.names[i] for i in leaves)
            raise RobotError(
                f"{where}: has {len(leaves)} chains, which end in {ends}; name a tool or the free joints in a graph, "
                "which `dmframe new` writes",
                path=("robot", "tool"),
            )
        index = leaves[0] if leaves else 0
    return {model.names[i] for i in model.supports[index] if i}


def _check_chain(model: Any, where: str) -> None:
    for parent in range(model.njoints):
        children = [model.names[i] for i in range(1, model.njoints) if model.parents[i] == parent]
        if len(children) > 1:
            fork = f"joint {model.names[parent]}" if parent else "the base"
            raise RobotError(
                f"{where}: expected the free joints to form one chain; at {fork} it branches into "
                f"{' and '.join(children)}: hold all branches but one",
                path=("robot", "free"),
            )


_BODY: Final = " (body)"


def _with_unique_frames(model: Any) -> Any:
    """Copy without joint frames that have a body's name, which Pinocchio's reduction rejects.

    The frame of a fixed joint keeps its new name; a body with the name of a moving joint is renamed back afterwards.
    """
    import pinocchio as pin

    copy = model.copy()
    bodies = {frame.name for frame in copy.frames if frame.type == pin.FrameType.BODY}
    joints = {frame.name for frame in copy.frames if frame.type == pin.FrameType.JOINT}
    for frame in copy.frames:
        if frame.type == pin.FrameType.FIXED_JOINT and frame.name in bodies:
            frame.name += " (fixed joint)"
        elif frame.type == pin.FrameType.BODY and frame.name in joints:
            frame.name += _BODY
    return copy


def _frame(model: Any, frame: str, where: str) -> int:
    """Index of a frame; a body's frame takes precedence over a joint's of the same name."""
    import pinocchio as pin

    found = [i for i, candidate in enumerate(model.frames) if candidate.name == frame]
    if not found:
        names = {candidate.name for candidate in model.frames if candidate.type != pin.FrameType.JOINT}
        raise UnknownNameError(f"{where}: tool: {frame}", "frame", frame, names, path=("robot", "tool"))
    return next((i for i in found if model.frames[i].type == pin.FrameType.BODY), found[0])


def _tool_frame(model: Any, tool: str | Sequence[float] | None, where: str) -> int:
    import pinocchio as pin

    last = model.njoints - 1
    if isinstance(tool, str):
        index = _frame(model, tool, where)
        if model.frames[index].parentJoint != last:
            moving = model.names[model.frames[index].parentJoint]
            raise RobotError(
                f"{where}: tool {tool} moves with {moving}, not with the last free joint {model.names[last]}; "
                "hold the joints behind the tool",
                path=("robot", "tool"),
            )
        return index
    if tool is None:
        bodies = [i for i, f in enumerate(model.frames) if f.type == pin.FrameType.BODY and f.parentJoint == last]
        tool, start = ((0.0, 0.0, 0.0), last) if not bodies else (None, bodies[-1])
        if tool is None:
            return start
    point = np.asarray(tool, dtype=float)
    if point.shape != (3,) or not np.all(np.isfinite(point)):
        raise ValueFault(
            f"{where}: expected the tool as a frame's name or 3 finite numbers in m, found {list(tool)}",
            path=("robot", "tool"),
        )
    if np.max(np.abs(point)) >= FARTHEST:
        raise ValueFault(
            f"{where}: expected the tool within {FARTHEST:g} m of the last joint, found {list(tool)}",
            path=("robot", "tool"),
        )
    placement = pin.SE3(np.eye(3), point)
    return int(model.addFrame(pin.Frame(TOOL_FRAME, last, 0, placement, pin.FrameType.OP_FRAME)))


def model_configuration(model: Any, angles: Mapping[str, float]) -> NDArray[np.float64]:
    """Neutral configuration of `model`, with the given one-degree joints at their values."""
    import pinocchio as pin

    configuration = np.array(pin.neutral(model), dtype=float)
    for name, angle in angles.items():
        joint = model.joints[model.getJointId(name)]
        value = (math.cos(angle), math.sin(angle)) if joint.nq == 2 else (angle,)
        configuration[joint.idx_q : joint.idx_q + joint.nq] = value
    return configuration


def motion_subspace(joint: Any) -> NDArray[np.float64]:
    """Unit velocity of a one-degree joint as a six-vector (linear, angular) in its own frame."""
    data, configuration = joint.createData(), np.zeros(joint.idx_q + joint.nq)
    if joint.nq == 2:
        configuration[joint.idx_q] = 1.0  # the cosine of an unbounded angle of 0
    joint.calc(data, configuration)  # sets the pitch of a helical joint
    subspace = data.S
    return np.array(subspace if isinstance(subspace, np.ndarray) else subspace.vector, dtype=float).reshape(-1)


def check_inertia(model: Any, name: str) -> None:
    """Raise `RobotError` for an invalid mass, or a mass matrix that is not positive definite.

    Raises
    ------
    RobotError
        The message names the joint.
    """
    import pinocchio as pin

    where = f"robot {name}"
    for index in range(1, model.njoints):
        parameters = model.inertias[index].toDynamicParameters()
        if not np.all(np.isfinite(parameters)) or parameters[0] < 0:
            raise RobotError(
                f"{where}: expected a finite mass >= 0 and a finite inertia behind joint {model.names[index]}, "
                f"found mass {parameters[0]:g}",
                path=("robot", "model"),
            )
    data = model.createData()
    for angle in (0.0, 0.7, -1.9):
        angles = {joint: angle * (1 + 0.3 * i) for i, joint in enumerate(list(model.names)[1:])}
        pin.crba(model, data, model_configuration(model, angles))
        upper = np.triu(data.M)
        joint = _weak_joint(upper + np.triu(upper, 1).T)
        if joint is not None:
            raise RobotError(
                f"{where}: the mass matrix is not positive definite: the links behind joint {model.names[joint + 1]} "
                "have too little mass or inertia; give its link an inertia, or hold it; `dmframe new FILE` "
                "writes a copy with placeholders",
                path=("robot", "model"),
            )


def _weak_joint(M: Any) -> int | None:
    """Joint for which a mass matrix is not positive definite, up to rounding; None if it is positive definite."""
    diagonal = np.diag(M)
    if np.min(diagonal) <= 0:
        # the last one: the links behind it have no inertia
        return int(np.flatnonzero(diagonal <= 0)[-1])
    scale = 1 / np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(M * np.outer(scale, scale))
    return int(np.argmax(np.abs(vectors[:, 0]))) if values[0] < 1e-10 else None
