"""Dynamic parameters a_d of a robot: their order, names, units and values."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, TypeVar, final

from dmframe.common.errors import UnknownNameError
from dmframe.common.names import Element
from dmframe.common.units import sliding

if TYPE_CHECKING:
    from dmframe.robot.chain import SerialChain

Friction = Literal["viscous", "coulomb"]
Part = Literal["inertial", "weighing", "rotor", "viscous", "coulomb", "bias"]
T = TypeVar("T")


class Inertial(NamedTuple):
    """Ten inertial parameters of a link, or a value for each, in the order of Pinocchio's `toDynamicParameters`.

    Mass, first moments, and inertia about the joint frame's origin, in its frame.
    """

    m: Any
    mc_x: Any
    mc_y: Any
    mc_z: Any
    I_xx: Any
    I_xy: Any
    I_yy: Any
    I_xz: Any
    I_yz: Any
    I_zz: Any


INERTIAL: Final = Inertial._fields
WEIGHING: Final = 4
"""Number of a link's parameters that gravity depends on: the leading mass and first moments."""

_UNITS: Final = {"m": "kg", "mc": "kg m", "I": "kg m^2"}
# By part of the joint's parameters: the name and, for a revolute joint, the unit.
_OF_JOINTS: Final[Mapping[Part, tuple[str, str]]] = {
    "rotor": ("I_r", "kg m^2"),
    "viscous": ("B", "N m s/rad"),
    "coulomb": ("D", "N m"),
    "bias": ("tau_bias", "N m"),
}


@final
@dataclass(frozen=True)
class DynamicParameters:
    """Layout of a_d, and of the columns of its regressor.

    Ten inertial parameters for each link; then, with `separate_gravity`, mass and first moments of each link for
    gravity; then, if enabled, one parameter for each joint for the inertia of its rotor, viscous friction, Coulomb
    friction, and a constant torque.

    Parameters
    ----------
    chain
        The robot.
    friction
        Any of "viscous", "coulomb" and "rotor", in any order: parameters of the joints.
    separate_gravity
        True if gravity has separate masses and first moments.
    bias
        True if each joint has a constant torque as a parameter.

    Raises
    ------
    UnknownNameError
        For another kind of friction.
    """

    chain: SerialChain
    friction: Collection[str] = ()
    separate_gravity: bool = False
    bias: bool = False

    def __post_init__(self) -> None:
        kinds = ("viscous", "coulomb", "rotor")
        for kind in self.friction:
            if kind not in kinds:
                raise UnknownNameError(f"friction {kind}", "kind of friction", kind, kinds)

    @property
    def parts(self) -> tuple[Part, ...]:
        """Parts in their order."""
        enabled: dict[Part, bool] = {
            "inertial": True,
            "weighing": self.separate_gravity,
            "rotor": "rotor" in self.friction,
            "viscous": "viscous" in self.friction,
            "coulomb": "coulomb" in self.friction,
            "bias": self.bias,
        }
        return tuple(part for part, wanted in enabled.items() if wanted)

    def in_order(self, given: Mapping[Part, T]) -> list[T]:
        """Values of the parts in their order, such as columns of a regressor."""
        return [given[part] for part in self.parts]

    @cached_property
    def elements(self) -> tuple[Element, ...]:
        """Names and units: m_1, mc_x1, ..., I_zzn; m_g1, mc_gx1, ...; I_r1, ...; B_1, ...; D_1, ...; tau_bias1, ..."""
        return tuple(element for part in self.parts for element in self._of(part))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of `elements`."""
        return tuple(element.name for element in self.elements)

    @property
    def size(self) -> int:
        """Number of parameters, p."""
        return len(self.elements)

    @property
    def inertial(self) -> slice:
        """Indices of the inertial parameters."""
        return self.places("inertial")

    def places(self, part: Part) -> slice:
        """Indices of a part; empty if it is not enabled."""
        if part not in self.parts:
            return slice(0, 0)
        start = sum(len(self._of(other)) for other in self.parts[: self.parts.index(part)])
        return slice(start, start + len(self._of(part)))

    def of_link(self, link: int) -> slice:
        """Indices of the inertial parameters of a link, counted from 0."""
        return slice(len(INERTIAL) * link, len(INERTIAL) * (link + 1))

    def link_of(self, place: int) -> int:
        """Link of an inertial parameter, counted from 0."""
        return place // len(INERTIAL)

    @property
    def values(self) -> tuple[Fraction | None, ...]:
        """Values in the robot's model; None for rotors, friction and bias."""
        rows = self.chain.inertia
        known: Mapping[Part, list[Fraction]] = {
            "inertial": [value for row in rows for value in row],
            "weighing": [value for row in rows for value in row[:WEIGHING]],
        }
        return tuple(value for part in self.parts for value in known.get(part, [None] * self.chain.n))

    def _of(self, part: Part) -> list[Element]:
        joints = list(enumerate(self.chain.joints, start=1))
        if part == "inertial":
            return [_inertial(name, link) for link, _ in joints for name in INERTIAL]
        if part == "weighing":
            return [_inertial(name, link, "g") for link, _ in joints for name in INERTIAL[:WEIGHING]]
        name, unit = _OF_JOINTS[part]
        return [
            Element(_indexed(name, str(i)), sliding(unit) if joint.kind == "prismatic" else unit) for i, joint in joints
        ]


def _inertial(name: str, link: int, mark: str = "") -> Element:
    stem, _, axes = name.partition("_")
    return Element(f"{stem}_{mark}{axes}{link}", _UNITS[stem])


def _indexed(name: str, index: str) -> str:
    return f"{name}{index}" if "_" in name else f"{name}_{index}"
