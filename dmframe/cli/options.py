"""What options say, and where they say nothing."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Final

from dmframe.errors import DmframeError, ValueFault
from dmframe.units import joint_place, shorten, to_unit

_WHOLE: Final = re.compile(r"\s*[-+]?[0-9]+\s*")


def quantity(option: str, text: str, unit: str, told: str = "") -> float:
    """A number, with a unit or in `unit`, as a graph would have it. Raises `ValueFault`, which names the option.

    `told` is what was typed, where that is more than `text`.
    """
    try:
        return to_unit(text, unit)
    except DmframeError as error:
        raise ValueFault(f"{option} {shorten(told or text)}: {error.text}") from None


def whole(option: str, text: str) -> int:
    """A whole number. Raises `ValueFault`, which names the option."""
    if len(text) > 30 or not _WHOLE.fullmatch(text):
        raise ValueFault(f"{option} {shorten(text)}: expected a whole number")
    return int(text)


def words(text: str | None) -> tuple[str, ...] | None:
    """The words that commas part; None where nothing was given."""
    return tuple(word.strip() for word in text.split(",") if word.strip()) if text else None


def formats_of(text: str) -> tuple[str, ...]:
    """Formats of figures, as commas part them. Raises `UnknownNameError`, which names the option."""
    from dmframe.plotting import checked_formats

    return checked_formats("--figures", words(text) or ("",))


def angles(option: str, pairs: Sequence[str]) -> dict[str, float]:
    """Places by joint [rad, or m for one that slides], each ``joint=angle``. Raises `ValueFault`, naming the option."""
    found = dict[str, float]()
    for pair in pairs:
        joint, equals, angle = (word.strip() for word in pair.partition("="))
        if not equals:
            raise ValueFault(f"{option} {pair}: expected joint=angle, for example wrist_2_joint='-90 deg'")
        if joint in found:
            raise ValueFault(f"{option} {pair}: {joint} is held twice; keep one of them")
        try:
            found[joint] = joint_place(angle)
        except DmframeError:
            found[joint] = quantity(option, angle, "rad", told=pair)
    return found


def refuse(options: Mapping[str, object], why: str) -> None:
    """Raise `ValueFault` for the first option that was given, but would do nothing."""
    for option, value in options.items():
        if value is not None and value is not False:
            raise ValueFault(f"{option}: {why}")
