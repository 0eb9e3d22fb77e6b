"""Load at the tool that changes in steps: ten inertial parameters."""

from __future__ import annotations

from typing import final

from pydantic import model_validator

from dmframe.block import TIME, AbstractBlock, Equations, Output, Real, Rows, Side, Signals, Table, Vector
from dmframe_blocks._loads import check_bodies, now_held


@final
class Payload(AbstractBlock):
    r"""A sequence of rigid bodies held by the tool, each fixed to the last link.

    A body with mass m, centre at r, and inertia I about its centre has the ten parameters m, m r and
    I + m (|r|^2 1 - r r') about the last joint's origin, in the axes of its frame; r is the sum of the tool's offset
    and `center`. They are added to those of the last link. `loaded_manipulator` reads them by name, without a wire;
    controllers cannot read them.

    Parameters
    ----------
    mass : list, kg
        Masses of the successive bodies; 0 for no load.
    at : list, s
        Increasing start times of the bodies; there is no load before the first.
    center : one row a body, (3,), m
        Centre of mass relative to the tool point, in the axes of the last joint's frame; by default the tool point.
    inertia : one row a body, (6,), kg m^2
        Inertia about the centre: xx, xy, yy, xz, yz, zz; by default a point mass.

    Notes
    -----
    A proof holds between two steps; V is discontinuous at each step. Not for: a load that swings.

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
        """The parameters of the present body."""
        return Equations({"a_load": now_held(u.t, p)})
