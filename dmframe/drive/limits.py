"""Limits of a robot, from its model and from the user's file, which may only tighten them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal, final

import numpy as np
from pydantic import BeforeValidator, Field, ValidationError

from dmframe.common.errors import DmframeError, DriveError, UnknownNameError, ValueFault, raise_all
from dmframe.common.units import plain, to_unit
from dmframe.config.document import Kind, read_file
from dmframe.config.grammar import Section, fault_of, shown
from dmframe.config.grammar import version as checked_version
from dmframe.config.places import placed
from dmframe.runtime.gate import Limits

LIMITS: Final = Kind("limits", "dmframe-limits: 1")
BRAKING: Final = (0.1, 1000.0)
"""Range of the deceleration of a stop [rad/s^2]."""


def _read(value: Any, unit: str) -> float:
    try:
        return to_unit(value, unit)
    except DmframeError as error:
        raise ValueError(error.text) from None


def _number(unit: str) -> BeforeValidator:
    def read(value: Any) -> float:
        number = _read(value, unit)
        if number <= 0:
            raise ValueError(f"expected a positive number in {unit}, found {shown(value)}")
        return number

    return BeforeValidator(read)


def _braking(value: Any) -> float:
    """Deceleration of a stop, which must end: within about a minute from 6.3 rad/s."""
    number = _read(value, "rad/s^2")
    if not BRAKING[0] <= number <= BRAKING[1]:
        least, most = (plain(end, "rad/s^2") for end in BRAKING)
        raise ValueError(f"expected {least} to {most}, found {shown(value)}")
    return number


def _count(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= 1000:
        raise ValueError(f"expected a whole number from 0 to 1000, found {shown(value)}")
    return value


@final
class LimitsFile(Section):
    """Keys of a limits file."""

    version: Annotated[Literal[1], BeforeValidator(checked_version)] = Field(alias="dmframe-limits")
    speed: Any = Field(None, description="of commands [rad/s]: one number, or by joint")
    acceleration: Any = Field(None, description="of commands [rad/s^2]: one number, or by joint")
    position: dict[str, Any] = Field({}, description="of joints [rad], {joint: [least, most]}")
    box: dict[str, Any] = Field({}, description="of the tool's coordinates [m], {x: [least, most]}")
    deceleration: Annotated[float, BeforeValidator(_braking)] = Field(
        2.0, description="at the end, after a stop request, and before joint limits"
    )
    halt: Annotated[float, BeforeValidator(_braking)] = Field(20.0, description="of a stop after a fault")
    deviation: Annotated[float, _number("rad")] = Field(0.2, description="between measured and target angles")
    lost: Annotated[int, BeforeValidator(_count)] = Field(5, description="samples in a row that may be lost")


KEYS: Final = tuple(item.alias or name for name, item in LimitsFile.model_fields.items())


def own_limits(robot: Any) -> Limits:
    """Limits of a robot's model.

    Raises
    ------
    DriveError
        There is no robot, or it has a prismatic joint.
    """
    if robot is None:
        raise DriveError("expected a graph with a robot, whose limits apply to commands, found none")
    sliding = [joint.name for joint in robot.joints if joint.kind != "revolute"]
    if sliding:
        raise DriveError(f"{sliding[0]}: expected revolute joints, found a prismatic one")
    lower, upper = (np.array([float(getattr(joint, key)) for joint in robot.joints]) for key in ("lower", "upper"))
    # some files without a speed limit have 0
    speed = np.array([joint.velocity if joint.velocity > 0 else math.inf for joint in robot.joints])
    return Limits([joint.name for joint in robot.joints], lower, upper, speed)


def load_limits(path: str | Path, robot: Any) -> Limits:
    """Limits of a robot, tightened by those of a file.

    Raises
    ------
    DmframeError
        All faults of the file, each with its line and column.
    """
    own, document = own_limits(robot), read_file(path, LIMITS)
    faults = list[DmframeError]()
    file: LimitsFile | None = None
    try:
        file = LimitsFile.model_validate(document.data)
    except ValidationError as error:
        faults += [fault_of(detail, lambda _: KEYS) for detail in error.errors(include_url=False)]
    reader = _Reader(document.data, own, robot, faults)
    made = reader.limits()
    try:
        raise_all(_once(faults))
    except DmframeError as error:
        raise placed(error, document, KEYS) from None
    assert file is not None  # an invalid file has faults
    given = {key: getattr(file, key) for key in ("deceleration", "halt", "deviation", "lost")}
    return replace(made, **given)


def _once(faults: list[DmframeError]) -> list[DmframeError]:
    return list({(fault.path, fault.text): fault for fault in faults}.values())


@final
class _Reader:
    """Reader of values by joint or by axis; it collects all faults."""

    def __init__(self, data: Mapping[str, Any], own: Limits, robot: Any, faults: list[DmframeError]) -> None:
        self.data, self.own, self.axes, self.faults = data, own, robot.axes, faults

    def limits(self) -> Limits:
        """Limits of the robot, tightened."""
        own, joints = self.own, self.own.joints
        speed = self._by_joint("speed", "rad/s", own.speed)
        acceleration = self._by_joint("acceleration", "rad/s^2", None)
        lower, upper = own.lower.copy(), own.upper.copy()
        for name, pair in self._pairs("position", "rad", joints, "joint"):
            k = list(joints).index(name)
            if pair[0] < lower[k] or pair[1] > upper[k]:
                self._note(
                    ("position", name),
                    f"expected angles within the robot's {lower[k]:.9g} to {upper[k]:.9g} rad, "
                    f"found {pair[0]:.9g} to {pair[1]:.9g} rad",
                )
            lower[k], upper[k] = pair
        box = np.array([[-math.inf] * len(self.axes), [math.inf] * len(self.axes)])
        pairs = self._pairs("box", "m", list(self.axes), "coordinate")
        for name, pair in pairs:
            box[:, list(self.axes).index(name)] = pair
        return replace(
            own, lower=lower, upper=upper, speed=speed, acceleration=acceleration, box=box if pairs else None
        )

    def _by_joint(self, key: str, unit: str, own: np.ndarray | None) -> Any:
        given, joints = self.data.get(key), list(self.own.joints)
        if given is None:
            return own
        found = np.full(len(joints), math.inf) if own is None else own.copy()
        if not isinstance(given, dict):
            number = self._positive(given, unit, (key,))
            return found if number is None else np.minimum(found, number)
        for name, value in given.items():
            if name not in joints:
                self.faults.append(UnknownNameError(f"{key}.{name}", "joint", name, joints, path=(key, name)))
                continue
            k, number = joints.index(name), self._positive(value, unit, (key, name))
            if number is not None and number > found[k]:
                text = f"expected at most {found[k]:.9g} {unit}, the robot's limit, found {number:.9g} {unit}"
                self._note((key, name), text)
            elif number is not None:
                found[k] = number
        lacking = [joint for joint in joints if joint not in given]
        if own is None and lacking:
            self._note((key,), f"expected a number for each joint, found none for {lacking[0]}")
        return found

    def _positive(self, value: Any, unit: str, path: tuple[str | int, ...]) -> float | None:
        number = self._quantity(value, unit, path)
        if number is None or number > 0:
            return number
        self._note(path, f"expected a positive number in {unit}, found {shown(value)}")
        return None

    def _pairs(self, key: str, unit: str, known: Any, kind: str) -> list[tuple[str, tuple[float, float]]]:
        given, found = self.data.get(key), list[tuple[str, tuple[float, float]]]()
        for name, value in given.items() if isinstance(given, dict) else ():
            path = (key, name)
            if name not in known:
                self.faults.append(UnknownNameError(f"{key}.{name}", kind, name, known, path=path))
            elif not isinstance(value, list) or len(value) != 2:
                self._note(path, f"expected the minimum and the maximum, [0.1, 0.8], found {shown(value)}")
            else:
                least, most = (self._quantity(item, unit, (*path, k)) for k, item in enumerate(value))
                if least is not None and most is not None and least >= most:
                    self._note(path, f"expected the minimum first, found {shown(value)}")
                elif least is not None and most is not None:
                    found.append((name, (least, most)))
        return found

    def _quantity(self, value: Any, unit: str, path: tuple[str | int, ...]) -> float | None:
        try:
            return to_unit(value, unit)
        except DmframeError as error:
            self._note(path, error.text, type(error))
            return None

    def _note(self, path: tuple[str | int, ...], text: str, kind: Callable[..., DmframeError] = ValueFault) -> None:
        self.faults.append(kind(f"{'.'.join(map(str, path))}: {text}", path=path))
