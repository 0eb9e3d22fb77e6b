"""How a point moves in a pinhole's image: linear in the nine numbers of the camera."""

from __future__ import annotations

from typing import Any

import casadi as ca


def pinhole(c: Any) -> tuple[Any, Any]:
    """N, which has the rows right and down, and ahead, of c = (right, down, ahead)."""
    right, down, ahead = ca.vertsplit(c, 3)
    return ca.vertcat(right.T, down.T), ahead


def image_regressor(eta: Any, e: Any, dx: Any) -> Any:
    """Y_c with Y_c c = (N - (eta - e/2) ahead') dx, half way between where a point is and where it should be."""
    return ca.vertcat(dx @ ca.DM([[1, 0]]), dx @ ca.DM([[0, 1]]), -dx @ (eta - e / 2).T).T
