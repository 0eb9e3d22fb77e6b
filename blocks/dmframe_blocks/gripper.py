"""Gripper signals: instants of load changes, and the expected loads."""

from __future__ import annotations

from typing import Any, final

import casadi as ca
from pydantic import model_validator

from dmframe.block import TIME, AbstractBlock, Equations, Output, Real, Rows, Side, Signals, Table, Vector
from dmframe_blocks._loads import check_bodies, check_times, now_held


@final
class Gripper(AbstractBlock):
    """Signals at known instants that the load at the tool has changed.

    `odd` is 0 before the first instant, then 1, then 0, and so on, like the open/closed signal of a gripper; it is read
    by a `reset_compensator`. The load itself is that of a `payload`, which controllers cannot read. The instants may be
    later than the changes of the load.

    Parameters
    ----------
    at : list, s
        Increasing instants of load changes.
    mass : list, kg
        Expected masses after each instant, if known, for example from a drawing; 0 for no load. They are added to the
        prior of the controller. Before the first instant no load is expected.
    center : one row a body, (3,), m
        As in `payload`.
    inertia : one row a body, (6,), kg m^2
        As in `payload`.

    Notes
    -----
    The output is piecewise constant: a proof holds between two instants. The expected loads may be wrong.
    """

    side = Side.SOURCE
    uses_robot = True
    inputs = (TIME,)
    outputs = (
        Output("odd", steps=True),
        Output("a_expected", "10", optional=True, steps=True),
    )

    at: Vector = Real("*", "s", spread=False)
    mass: Vector | None = Real("*", "kg", default=None, spread=False)
    center: Table | None = Rows("3", "m", default=None)
    inertia: Table | None = Rows("6", "kg m^2", default=None)

    @model_validator(mode="after")
    def _bodies(self) -> Gripper:
        if self.mass is not None:
            check_bodies(self.at, self.mass, self.center, self.inertia)
        elif self.center or self.inertia:
            raise ValueError("expected a mass for each center and inertia, found none")
        check_times(self.at)
        return self

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """A step up at each odd instant, and a step down at each even one."""
        odd: Any = 0
        for k, at in enumerate(ca.vertsplit(p.at)):
            odd += (-1) ** k * (u.t >= at)
        return Equations({"odd": odd, **({"a_expected": now_held(u.t, p)} if "mass" in p else {})})
