"""Lines of aligned equations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final


@final
@dataclass(frozen=True)
class Row:
    """One line of aligned equations: what stands left and right of the alignment, and its number."""

    left: str
    right: str
    tag: str = ""
