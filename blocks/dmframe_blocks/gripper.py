"""What a gripper tells of its loads: when another one is there, and what is expected of it."""

from __future__ import annotations

from typing import Any, final

import casadi as ca
from pydantic import model_validator

from dmframe.block import TIME, AbstractBlock, Equations, Output, Real, Rows, Side, Signals, Table, Vector
from dmframe_blocks._loads import check_bodies, check_times, now_held


@final
class Gripper(AbstractBlock):
    """Tells at known instants that the tool holds another load than before.

    `odd` is 0 until the first of them, then 1, then 0, and so on: a signal that every gripper has, open or closed, for
    a `reset_compensator`. The load itself is that of a `payload`, of which nobody is told; a gripper may be late.

    Parameters
    ----------
    at : list, s
        When another load is there, increasing.
    mass : list, kg
        What is expected to be there then, if anything is, beside what the controller holds for true before it learns:
        a part by its drawing, 0 for none. Before the first instant, none.
    center : one row a body, (3,), m
        As of a `payload`.
    inertia : one row a body, (6,), kg m^2
        As of a `payload`.

    Notes
    -----
    It steps: a proof is one of the time between two of its instants. What is expected may be wrong.
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
        """1 more at each instant, and 1 less at the next."""
        odd: Any = 0
        for k, at in enumerate(ca.vertsplit(p.at)):
            odd += (-1) ** k * (u.t >= at)
        return Equations({"odd": odd, **({"a_expected": now_held(u.t, p)} if "mass" in p else {})})
