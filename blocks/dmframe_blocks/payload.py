"""A load at the tool that changes in steps: ten inertial parameters."""

from __future__ import annotations

from typing import final

from pydantic import model_validator

from dmframe.block import TIME, AbstractBlock, Equations, Output, Real, Rows, Side, Signals, Table, Vector
from dmframe_blocks._loads import check_bodies, now_held


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

    side = Side.SOURCE
    uses_robot = True
    inputs = (TIME,)
    outputs = (Output("a_load", "10", steps=True),)

    mass: Vector = Real("*", "kg", spread=False)
    at: Vector = Real("*", "s", spread=False)
    center: Table | None = Rows("3", "m", default=None)
    inertia: Table | None = Rows("6", "kg m^2", default=None)

    @model_validator(mode="after")
    def _bodies(self) -> Payload:
        check_bodies(self.at, self.mass, self.center, self.inertia)
        return self

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """One after another."""
        return Equations({"a_load": now_held(u.t, p)})
