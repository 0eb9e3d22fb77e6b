"""The motion of a point in a pinhole's image, half way between where it is and where it should be."""

from __future__ import annotations

from typing import Any

import casadi as ca

from dmframe.naming import operation


@operation
def halfway(c: Any, eta: Any, e: Any) -> Any:
    """N - (eta - e/2) ahead' of c = (right, down, ahead): z |e|^2/2 grows by e' of this, times the tool's velocity."""
    right, down, ahead = ca.vertsplit(c, 3)
    return ca.vertcat(right.T, down.T) - (eta - e / 2) @ ahead.T


@operation
def learnt(eta: Any, e: Any, dx: Any, by: Any) -> Any:
    """The gradient of by' halfway(c, eta, e) dx with respect to c: linear in by."""
    return ca.vertcat(by[0] * dx, by[1] * dx, -ca.dot(by, eta - e / 2) * dx)
