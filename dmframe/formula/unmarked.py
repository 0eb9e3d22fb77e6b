"""Marked text, with formulas in dollar signs and code in backticks, converted for a terminal or an editor."""

from __future__ import annotations

import re

from dmframe.formula.latex import in_unicode


def unmarked(text: str) -> str:
    """The text without marks, with formulas in Unicode."""
    pieces = re.split(r"\$([^$]*)\$", text)
    return "".join(in_unicode(piece) if place % 2 else piece for place, piece in enumerate(pieces)).replace("`", "")
