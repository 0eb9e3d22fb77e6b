"""Parse the values of options, and reject options without effect."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Final

from dmframe.common.errors import DmframeError, ValueFault
from dmframe.common.units import joint_place, shorten, to_unit

_WHOLE: Final = re.compile(r"\s*[-+]?[0-9]+\s*")


def quantity(option: str, text: str, unit: str, typed: str = "") -> float:
    """Parse a quantity, with a unit or in `unit`; raises `ValueFault` with the option and the `typed` text."""
    try:
        return to_unit(text, unit)
    except DmframeError as error:
        raise ValueFault(f"{option} {shorten(typed or text)}: {error.text}") from None


def whole(option: str, text: str) -> int:
    """Parse an integer; raises `ValueFault`."""
    if len(text) > 30 or not _WHOLE.fullmatch(text):
        raise ValueFault(f"{option} {shorten(text)}: expected a whole number")
    return int(text)


def words(text: str | None) -> tuple[str, ...] | None:
    """Split comma-separated words; None for an absent option."""
    return tuple(word.strip() for word in text.split(",") if word.strip()) if text else None


def formats_of(text: str) -> tuple[str, ...]:
    """Parse comma-separated figure formats; raises `UnknownNameError`."""
    from dmframe.common.plotting import checked_formats

    return checked_formats("--figures", words(text) or ("",))


def angles(option: str, pairs: Sequence[str]) -> dict[str, float]:
    """Parse joint positions ``joint=angle`` [rad, or m if prismatic]; raises `ValueFault`."""
    found = dict[str, float]()
    for pair in pairs:
        joint, equals, angle = (word.strip() for word in pair.partition("="))
        if not equals:
            raise ValueFault(f"{option} {pair}: expected joint=angle, for example wrist_2_joint='-90 deg'")
        if joint in found:
            raise ValueFault(f"{option} {pair}: {joint} is given twice; keep one of them")
        try:
            found[joint] = joint_place(angle)
        except DmframeError:
            found[joint] = quantity(option, angle, "rad", typed=pair)
    return found


def refuse(options: Mapping[str, object], why: str) -> None:
    """Raise `ValueFault` for the first given option, which would have no effect."""
    for option, value in options.items():
        if value is not None and value is not False:
            raise ValueFault(f"{option}: {why}")
