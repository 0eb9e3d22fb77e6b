"""What a caller of bounds gives: the length of the run and the disturbance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from dmframe.common.errors import DmframeError, ValueFault
from dmframe.common.units import to_unit

OVER: Final = 60.0
"""Length of the run without another one [s]."""

Torque = float | str | Sequence[float | str]
"""One torque for all joints or one for each, ``5 N m`` or ``5 N m, 5 N m, 2 N m``."""


def torques_of(given: Torque, joints: int) -> tuple[float, ...]:
    """The bound on a disturbance torque at each joint [N m].

    Raises `ValueFault` for another unit, another number of joints, or a torque below zero.
    """
    items = given.split(",") if isinstance(given, str) else [given] if isinstance(given, int | float) else list(given)
    try:
        found = [to_unit(item, "N m") for item in items]
    except DmframeError as error:
        raise ValueFault(f"disturbance: {error.text}") from None
    found = found * joints if len(found) == 1 else found
    if len(found) != joints or min(found, default=0.0) < 0:
        text = f"disturbance: expected one torque, or one for each of {joints} joints, of 0 N m or above, found {given}"
        raise ValueFault(text)
    return tuple(found)
