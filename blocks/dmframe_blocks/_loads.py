"""A sequence of rigid bodies held by the tool: their ten inertial parameters, and checks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from dmframe.block import SX, Signals, operation

Row = Sequence[float]


def check_bodies(at: Row, mass: Row, center: Sequence[Row] | None, inertia: Sequence[Row] | None) -> None:
    """Raise `ValueError` for lists of unequal lengths, times that do not increase, and inconsistent inertias."""
    count = len(mass)
    for name, rows in (("at", at), ("center", center), ("inertia", inertia)):
        if rows is not None and len(rows) != count:
            raise ValueError(f"expected {name} for each of {count} masses, found {len(rows)}")
    check_times(at)
    for heavy, row in zip(mass, inertia or [[0.0] * 6] * count, strict=True):
        xx, xy, yy, xz, yz, zz = row
        second = (xx + yy + zz) / 2 * np.eye(3) - np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if heavy < 0 or np.linalg.eigvalsh(second)[0] < -1e-12 or (heavy == 0 and any(row)):
            found = f"found mass {heavy:g} with inertia {list(row)}"
            why = "no principal moment is more than the sum of the other two, and without mass there is none"
            raise ValueError(f"expected rigid bodies, {found}; a mass is 0 or above, {why}")


def check_times(at: Row) -> None:
    """Raise `ValueError` for times that do not increase."""
    if any(later <= earlier for earlier, later in pairwise(at)):
        raise ValueError(f"expected increasing times, found {list(at)}")


def now_held(t: SX, p: Signals) -> SX:
    """The ten parameters of the present body, for a block with `mass`, `at`, `center` and `inertia`."""
    count = p.mass.numel()
    center = p.center if "center" in p else ca.DM.zeros(count, 3)
    inertia = p.inertia if "inertia" in p else ca.DM.zeros(count, 6)
    return held(t, p.mass, p.at, center, inertia, p.robot.a_k)


@operation
def held(t: Any, mass: Any, at: Any, center: Any, inertia: Any, a_k: Any) -> Any:
    """The parameters of the last body whose time has come, zero before the first."""
    a_load, before = ca.SX.zeros(10), ca.SX.zeros(10)
    for k in range(mass.numel()):
        now = body(mass[k], a_k[-3:] + center[k, :].T, inertia[k, :].T)
        a_load, before = a_load + (now - before) * (t >= at[k]), now
    return a_load


def body(mass: Any, r: Any, inertia: Any) -> Any:
    """The ten parameters, about the origin, of a body with centre r, in the order of `robot.parameters.Inertial`."""
    x, y, z = ca.vertsplit(r)
    about = ca.vertcat(y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y)
    return ca.vertcat(mass, mass * r, inertia + mass * about)


@operation
def with_body(inertia: Any, body: Any) -> Any:
    """The inertial parameters with a body added to the last link; or those with weight, with those of the body."""
    size = body.shape[0]
    return ca.vertcat(inertia[:-size], inertia[-size:] + body)


def with_held(inertia: Any, held: Any, part: Callable[[Any], Any] = lambda body: body) -> Any:
    """`with_body` for the body at the plant's tool, or for a part of it; the robot's own parameters without a body."""
    return inertia if held.is_zero() else with_body(inertia, part(held))
