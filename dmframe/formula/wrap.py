"""Line breaks in formulas: before a + or - outside of all brackets, and inside of brackets only if necessary."""

from __future__ import annotations

import re
from typing import Final

from dmframe.common.columns import width

_SIGNS: Final = ("+", "-", "−", "=")
_NORM: Final = 10
"""Penalty of a break inside a norm, relative to one inside brackets."""


def wrapped(text: str, wide: int) -> list[str]:
    """A formula in lines of at most `wide` characters; a line without a break may be longer."""
    if width(text) <= wide:
        return [text]
    places = _places(text)
    if not places:
        return [text]
    best = min(cost for _, cost in places)
    cuts = [place for place, cost in places if cost == best]
    pieces = [text[a:b].strip() for a, b in zip([0, *cuts], [*cuts, len(text)], strict=True)]
    lines = [""]
    for piece in pieces:
        longer = f"{lines[-1]} {piece}".strip()
        if width(longer) <= wide:
            lines[-1] = longer
        else:
            lines += [line for line in wrapped(piece, wide) if line]
    return [line for line in lines if line]


def _places(text: str) -> list[tuple[int, int]]:
    """Blanks at which a line may end, each with its penalty: the depth of brackets, and a missing sign after it."""
    found, depth, bars = list[tuple[int, int]](), 0, list[int]()
    for place, letter in enumerate(text):
        if letter in "([":
            depth += 1
        elif letter in ")]":
            depth -= 1
        elif letter == "|":
            opens = place == 0 or text[place - 1] in " ([|−-"
            if opens:
                bars.append(depth)
            elif bars:
                bars.pop()
        elif letter == " " and re.match(r" [^+\-−=]| [+\-−=] ", text[place:]) and text[place - 1] not in _SIGNS:
            signed = text[place + 1] in _SIGNS
            found.append((place, 2 * depth + 2 * _NORM * len(bars) + (not signed)))
    return found
