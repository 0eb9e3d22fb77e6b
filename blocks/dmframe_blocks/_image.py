"""Motion of a point in a pinhole image, linear in the nine parameters of the camera."""

from __future__ import annotations

from typing import Any

import casadi as ca


def pinhole(a_c: Any) -> tuple[Any, Any]:
    """N with the rows right and down, and the column ahead, from a_c = (right, down, ahead)."""
    right, down, ahead = ca.vertsplit(a_c, 3)
    return ca.vertcat(right.T, down.T), ahead


def image_regressor(chi: Any, e: Any, dx: Any) -> Any:
    """Y_c with Y_c a_c = (N - (chi - e/2) ahead') dx, evaluated half way between the point and its goal."""
    return ca.vertcat(dx @ ca.DM([[1, 0]]), dx @ ca.DM([[0, 1]]), -dx @ (chi - e / 2).T).T
