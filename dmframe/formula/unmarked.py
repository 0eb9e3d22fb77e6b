"""Marked text, with formulas between dollar signs and code between backticks, as a terminal or an editor shows it."""

from __future__ import annotations

import re

from dmframe.formula.latex import in_unicode


def unmarked(text: str) -> str:
    """The text without its marks, formulas in Unicode."""
    pieces = re.split(r"\$([^$]*)\$", text)
    return "".join(in_unicode(piece) if place % 2 else piece for place, piece in enumerate(pieces)).replace("`", "")
