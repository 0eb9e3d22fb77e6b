"""What options say, and where they say nothing."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

from dmframe.errors import DmframeError, ValueFault
from dmframe.units import shorten, to_unit

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


def refuse(options: Mapping[str, object], why: str) -> None:
    """Raise `ValueFault` for the first option that was given, but would do nothing."""
    for option, value in options.items():
        if value is not None and value is not False:
            raise ValueFault(f"{option}: {why}")
