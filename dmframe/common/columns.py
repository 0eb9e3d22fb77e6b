"""Text tables with aligned columns."""

from __future__ import annotations

import shutil
import unicodedata
from collections.abc import Iterable, Sequence


def columns(rows: Iterable[Sequence[str]], indent: str = "  ", right: Sequence[int] = ()) -> str:
    """One line per row; the columns in `right` (from 0) are right-aligned."""
    table = [list(row) for row in rows]
    if not table:
        return f"{indent}none"
    widths = [max(width(row[k]) for row in table) for k in range(len(table[0]))]
    lines = ("  ".join(_cell(cell, widths[k], k in right) for k, cell in enumerate(row)) for row in table)
    return "\n".join(f"{indent}{line}".rstrip() for line in lines)


def width(text: str) -> int:
    """Width of a text in characters, without combining accents."""
    return sum(not unicodedata.combining(letter) for letter in text)


def page_width() -> int:
    """Page width: that of the terminal or of COLUMNS, at most 120; 120 without either."""
    return max(40, min(120, shutil.get_terminal_size((120, 24)).columns))


def _cell(text: str, wide: int, right: bool) -> str:
    room = " " * (wide - width(text))
    return room + text if right else text + room
