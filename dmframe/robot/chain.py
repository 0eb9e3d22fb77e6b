"""Serial chain of one-degree-of-freedom joints with rational numbers and exactly orthogonal rotations."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Literal, final

import numpy as np
from numpy.typing import NDArray

from dmframe.common import notebook
from dmframe.common.errors import ValueFault
from dmframe.robot.mimics import Mimic
from dmframe.robot.rational import Matrix, Vector, decimal, rational_axis, rational_rotation
from dmframe.robot.reduction import check_inertia, model_configuration, motion_subspace, reduce_model
from dmframe.robot.urdf import read_urdf

AXES = ("x", "y", "z", "xy", "xz", "yz", "xyz")
# Smaller translations are rounding errors of a quarter turn with ten digits. [m]
NOTHING = 1e-11


@final
@dataclass(frozen=True)
class Joint:
    """Joint: its frame at q = 0 in the parent's, its axis in its own frame, and the maker's limits.

    `rotation` maps coordinates of this frame to the parent's, as Pinocchio's `jointPlacements` do. Limits in rad,
    rad/s and N m (m, m/s and N for a prismatic joint); infinite if the file has none.
    """

    name: str
    kind: Literal["revolute", "prismatic"]
    axis: Vector
    rotation: Matrix
    translation: Vector
    lower: float
    upper: float
    velocity: float
    effort: float

    EXACT: ClassVar = ("axis", "rotation", "translation")
    """Fields with rational numbers."""


@final
@dataclass(frozen=True, repr=False)
class SerialChain:
    """A robot whose free joints form one chain; held joints are merged into the links before them.

    Attributes
    ----------
    joints : n joints, from the base to the tool
    tool : (3,), m
        Tool position in the last joint's frame.
    tool_rotation : (3, 3)
        Rotation from the tool's frame to the last joint's.
    inertia : n rows of 10
        The elements of `dmframe.robot.parameters.Inertial`, link by link.
    gravity : (3,), m/s^2
    axes : "xyz", "xy", ...
        Coordinates of the tool position in the task.
    rotation_change : largest change of a rotation's or axis's entry by the rational approximation
    model, model_tool : reduced `pin.Model` and its tool frame, the reference for tests
    friction_velocity : rad/s
        Velocity at which smooth Coulomb friction reaches tanh(1).
    """

    name: str
    joints: tuple[Joint, ...]
    tool: Vector
    tool_rotation: Matrix
    inertia: tuple[Vector, ...]
    gravity: Vector
    axes: str
    rotation_change: float
    friction_velocity: float
    model: Any = field(compare=False, repr=False)
    model_tool: int = field(compare=False, repr=False)

    def __repr__(self) -> str:
        return f"<SerialChain {self.name}: {self.n} joints, {', '.join(self.joint_names)}>"

    def _repr_html_(self) -> str:
        """HTML table of the joints with their limits."""
        rows = [
            (
                joint.name,
                joint.kind,
                *(f"{value:.4g}" for value in (joint.lower, joint.upper, joint.velocity, joint.effort)),
            )
            for joint in self.joints
        ]
        heads = ("joint", "kind", "lower", "upper", "velocity", "effort")
        return notebook.heading(self.name, f"task coordinates {self.axes}") + notebook.table(rows, heads)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def m(self) -> int:
        """Number of task coordinates."""
        return len(self.axes)

    @property
    def k(self) -> int:
        """Number of kinematic parameters: a translation per joint, and the tool's."""
        return 3 * (self.n + 1)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the free joints, from the base to the tool."""
        return tuple(joint.name for joint in self.joints)

    @classmethod
    def with_lazy_model(cls, numbers: Mapping[str, Any], load: Callable[[], SerialChain]) -> SerialChain:
        """Chain with given numbers; its model is that of `load()`, called at the first use."""
        chain = object.__new__(cls)
        vars(chain).update(numbers, _load=load)
        return chain

    def with_other_numbers(self, numbers: Mapping[str, Any], model: Callable[[], Any]) -> SerialChain:
        """Copy with other numbers, whose model is that of `model()`, called at the first use."""
        own = {item.name: getattr(self, item.name) for item in fields(self) if not item.name.startswith("model")}

        def load() -> SerialChain:
            return replace(self, model=model(), model_tool=self.model_tool)

        return self.with_lazy_model({**own, **numbers}, load)

    def __getattr__(self, name: str) -> Any:
        """Model of a chain made by `with_lazy_model`."""
        load = vars(self).get("_load")
        if load is None or name not in ("model", "model_tool"):
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        made = load()
        vars(self).update(model=made.model, model_tool=made.model_tool)
        return vars(self)[name]

    @classmethod
    def from_urdf(
        cls,
        path: str | Path,
        *,
        free: Sequence[str] | None = None,
        hold: Mapping[str, float] | None = None,
        tool: str | Sequence[float] | None = None,
        axes: str = "xyz",
        name: str | None = None,
        friction_velocity: float = 0.005,
    ) -> SerialChain:
        """Chain of a URDF file; see :meth:`from_model` for the arguments.

        Raises
        ------
        MissingError, RobotError
            No such file, or not a URDF: see :func:`dmframe.robot.urdf.read_urdf`.
        """
        model, mimics = read_urdf(Path(path), free=free, hold=hold or (), tool=tool)
        return cls.from_model(
            model,
            free=free,
            hold=hold,
            tool=tool,
            axes=axes,
            name=name,
            friction_velocity=friction_velocity,
            mimics=mimics,
        )

    @classmethod
    def from_model(
        cls,
        model: Any,
        *,
        free: Sequence[str] | None = None,
        hold: Mapping[str, float] | None = None,
        tool: str | Sequence[float] | None = None,
        axes: str = "xyz",
        name: str | None = None,
        friction_velocity: float = 0.005,
        mimics: Mapping[str, Mimic] = MappingProxyType({}),
    ) -> SerialChain:
        """Chain of a `pin.Model`.

        Parameters
        ----------
        free : joint names, in any order
            All others are locked, at `hold` or at 0. Default: the joints between base and tool that are not in `hold`.
        hold : joint name to angle, rad (m for a prismatic joint)
        tool : frame name, or (3,) in m in the last free joint's frame
            Default: the last body frame of the only chain.
        axes : one of x, y, z, xy, xz, yz, xyz
        mimics : joints that follow another, with their laws
            They are not free: if the leader is held, their law determines their angle.

        Raises
        ------
        UnknownNameError
            The robot does not have a joint or a frame of this name.
        ValueFault
            An argument is out of range.
        RobotError
            The free joints are not a chain of revolute and prismatic joints, or the robot has no inertia.
        """
        name = name or model.name
        _check_numbers(name, axes, friction_velocity)
        reduced, tool_frame = reduce_model(model, name, free=free, hold=hold or {}, tool=tool, mimics=mimics)
        check_inertia(reduced, name)
        built = [_joint(reduced, i) for i in range(1, reduced.njoints)]
        tool_placement = reduced.frames[tool_frame].placement
        tool_rotation, tool_change = _rotation(tool_placement)
        return cls(
            name=name,
            joints=tuple(joint for joint, _ in built),
            tool=_translation(tool_placement),
            tool_rotation=tool_rotation,
            inertia=tuple(_decimals(body.toDynamicParameters()) for body in list(reduced.inertias)[1:]),
            gravity=_decimals(reduced.gravity.linear),
            axes=axes,
            rotation_change=max(tool_change, *(change for _, change in built)),
            friction_velocity=float(friction_velocity),
            model=reduced,
            model_tool=tool_frame,
        )


def pin_configuration(chain: SerialChain, q: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Configuration of `chain.model` at joint angles q; Pinocchio represents an unbounded angle by cosine and sine."""
    return model_configuration(chain.model, dict(zip(chain.joint_names, np.asarray(q, dtype=float), strict=True)))


def _check_numbers(name: str, axes: str, friction_velocity: float) -> None:
    if axes not in AXES:
        raise ValueFault(
            f"robot {name}: expected axes to be one of {', '.join(AXES)}; found {axes!r}", path=("robot", "axes")
        )
    if not (math.isfinite(friction_velocity) and friction_velocity > 0):
        raise ValueFault(
            f"robot {name}: expected a friction velocity > 0 in rad/s, found {friction_velocity}",
            path=("robot", "friction_velocity"),
        )


def _joint(model: Any, index: int) -> tuple[Joint, float]:
    """Joint of a reduced model with rational numbers, and its largest change by rounding."""
    joint, placement = model.joints[index], model.jointPlacements[index]
    subspace = motion_subspace(joint)
    revolute = bool(np.any(subspace[3:]))
    axis = subspace[3:] if revolute else subspace[:3]
    exact_axis, (exact_rotation, turned) = rational_axis(axis), _rotation(placement)
    change = max(float(np.max(np.abs(np.array(exact_axis, dtype=float) - axis))), turned)
    bounded = joint.nq == 1
    return Joint(
        name=model.names[index],
        kind="revolute" if revolute else "prismatic",
        axis=exact_axis,
        rotation=exact_rotation,
        translation=_translation(placement),
        lower=_limit(model.lowerPositionLimit[joint.idx_q]) if bounded else -math.inf,
        upper=_limit(model.upperPositionLimit[joint.idx_q]) if bounded else math.inf,
        velocity=_limit(model.velocityLimit[joint.idx_v]),
        effort=_limit(model.effortLimit[joint.idx_v]),
    ), change


def _rotation(placement: Any) -> tuple[Matrix, float]:
    """Rational rotation of a placement, and the largest change of an entry."""
    exact = rational_rotation(placement.rotation)
    return exact, float(np.max(np.abs(np.array(exact, dtype=float) - placement.rotation)))


def _limit(value: float) -> float:
    """A limit; infinite for Pinocchio's largest double, which means no limit."""
    return float(value) if abs(value) < 1e300 else math.copysign(math.inf, value)


def _translation(placement: Any) -> Vector:
    return tuple(Fraction(0) if abs(x) < NOTHING else decimal(x) for x in placement.translation)


def _decimals(values: NDArray[np.float64]) -> Vector:
    return tuple(decimal(x) for x in values)
