"""A load at the tool that changes in steps: ten inertial parameters."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, ClassVar, final

import casadi as ca
import numpy as np
from pydantic import model_validator

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.naming import operation
from dmframe.parameter import Real, Rows, Table, Vector
from dmframe.port import TIME, Port, Side


@final
class Payload(AbstractBlock):
    r"""What the tool holds: bodies, one after another, each rigid and fixed to the last link.

    A body of mass m whose centre is at r, and whose inertia about its centre is I, has the ten parameters m, m r and
    I + m (|r|^2 1 - r r') about the last joint's origin, in the axes of its frame; r is the tool's offset and `center`.
    They add to the last link's own. `loaded_manipulator` reads them by name, without a wire, and no controller does.

    Parameters
    ----------
    mass : list, kg
        One body after another; 0 puts the load down.
    at : list, s
        When each of them is there, increasing; before the first there is none.
    center : one row a body, (3,), m
        Centre of mass, from the tool's point, in the axes of the last joint's frame. Left out, it is at the tool.
    inertia : one row a body, (6,), kg m^2
        Of the body about its centre: xx, xy, yy, xz, yz, zz. Left out, it is a point.

    Notes
    -----
    A proof is one of the time between two steps; V is another after each. Not for: a load that swings.

    References
    ----------
    [Siciliano2009]_ Section 7.2.
    """

    side: ClassVar[Side] = Side.SOURCE
    uses_robot: ClassVar[bool] = True
    inputs: ClassVar[tuple[Port, ...]] = (TIME,)
    outputs: ClassVar[tuple[Port, ...]] = (Port("a_load", "10", steps=True),)

    mass: Vector = Real("*", "kg", spread=False)
    at: Vector = Real("*", "s", spread=False)
    center: Table | None = Rows("3", "m", default=None)
    inertia: Table | None = Rows("6", "kg m^2", default=None)

    @model_validator(mode="after")
    def _bodies(self) -> Payload:
        count = len(self.mass)
        for name, rows in (("at", self.at), ("center", self.center), ("inertia", self.inertia)):
            if rows is not None and len(rows) != count:
                raise ValueError(f"expected {name} for each of {count} masses, found {len(rows)}")
        if any(later <= earlier for earlier, later in pairwise(self.at)):
            raise ValueError(f"expected increasing times, found {list(self.at)}")
        for mass, row in zip(self.mass, self.inertia or [[0.0] * 6] * count, strict=True):
            xx, xy, yy, xz, yz, zz = row
            second = (xx + yy + zz) / 2 * np.eye(3) - np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            if mass < 0 or np.linalg.eigvalsh(second)[0] < -1e-12 or (mass == 0 and any(row)):
                found = f"found mass {mass:g} with inertia {list(row)}"
                why = "no principal moment is more than the sum of the other two, and without mass there is none"
                raise ValueError(f"expected rigid bodies, {found}; a mass is 0 or above, {why}")
        return self

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """One after another."""
        count = p.mass.numel()
        center = p.center if "center" in p else ca.DM.zeros(count, 3)
        inertia = p.inertia if "inertia" in p else ca.DM.zeros(count, 6)
        return Equations({"a_load": held(u.t, p.mass, p.at, center, inertia, p.robot.a_k)})


@operation
def held(t: Any, mass: Any, at: Any, center: Any, inertia: Any, a_k: Any) -> Any:
    """The parameters of the last body whose time has come, nothing before the first."""
    a_load, before = ca.SX.zeros(10), ca.SX.zeros(10)
    for k in range(mass.numel()):
        now = body(mass[k], a_k[-3:] + center[k, :].T, inertia[k, :].T)
        a_load, before = a_load + (now - before) * (t >= at[k]), now
    return a_load


def body(mass: Any, r: Any, inertia: Any) -> Any:
    """The ten parameters of a body about the origin, its centre at r, in the order of `robot.parameters.Inertial`."""
    x, y, z = ca.vertsplit(r)
    about = ca.vertcat(y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y)
    return ca.vertcat(mass, mass * r, inertia + mass * about)
