"""How a point moves in a pinhole's image: linear in the nine numbers of the camera."""

from __future__ import annotations

from typing import Any

import casadi as ca


def pinhole(a_c: Any) -> tuple[Any, Any]:
    """N, which has the rows right and down, and ahead, of a_c = (right, down, ahead)."""
    right, down, ahead = ca.vertsplit(a_c, 3)
    return ca.vertcat(right.T, down.T), ahead


def image_regressor(chi: Any, e: Any, dx: Any) -> Any:
    """Y_c with Y_c a_c = (N - (chi - e/2) ahead') dx, half way between where a point is and where it should be."""
    return ca.vertcat(dx @ ca.DM([[1, 0]]), dx @ ca.DM([[0, 1]]), -dx @ (chi - e / 2).T).T
