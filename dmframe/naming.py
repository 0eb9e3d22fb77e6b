"""Names for parts of a law, so that they print as a reader writes them."""

from __future__ import annotations

from typing import Any


def named(name: str, expression: Any) -> Any:
    """Give a part of a law a name, ``named("K_star", truth.K * truth.K_P)``."""
    del name
    return expression
