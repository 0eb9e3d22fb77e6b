"""Checks of directions given by users: of any length whose square is a floating-point number."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

SHORTEST: Final = 1e-100
LONGEST: Final = 1e100
FLAT: Final = 1e-6
"""Volume spanned by three unit vectors below which they count as coplanar."""


def check_direction(name: str, values: Sequence[float]) -> None:
    """Raise `ValueError` for a direction of length zero, or so short or long that its square under- or overflows."""
    if not SHORTEST <= math.hypot(*values) <= LONGEST:
        found = f"{list(values)}, of length {math.hypot(*values):g}"
        raise ValueError(f"{name}: expected a direction, of a length from {SHORTEST:g} to {LONGEST:g}, found {found}")


def check_space(**directions: Sequence[float]) -> None:
    """Raise `ValueError` for an invalid direction, and for three coplanar ones."""
    for name, values in directions.items():
        check_direction(name, values)
    rows = np.array([np.asarray(values) / math.hypot(*values) for values in directions.values()])
    if abs(np.linalg.det(rows)) < FLAT:
        found = ", ".join(f"{name} {list(values)}" for name, values in directions.items())
        raise ValueError(f"expected directions that do not lie in one plane, found {found}")
