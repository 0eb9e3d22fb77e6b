"""Path of the joints through points, and the path of the tool that belongs to it."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal, final

import casadi as ca
from pydantic import model_validator

from dmframe.block import TIME, AbstractBlock, Equations, Output, Real, Rows, Side, Signals, Table, Vector
from dmframe_blocks.waypoints import check_rates, path_time, through


@final
class JointWaypoints(AbstractBlock):
    r"""Path of the joints as that of `waypoints`, and the path of the tool by the kinematics of the robot.

    .. math::

        x_d = f(q_d)   \tag{1}

    The tracking error is then that of the tool's position. ``dmframe path FILE ROBOT --joints`` and ``dmframe design``
    write this block from a path of the tool, whose joint positions they compute by inverse kinematics.

    Parameters
    ----------
    times : list, s
        Increasing times at which the points are reached.
    q_d : one row a time, (n,), rad
        Points of the joints.
    dq_d, ddq_d : one row a time, (n,)
        Velocities and accelerations there; by default zero. Those of the first and of the last point have to be zero.
    after : stays, repeats or returns
        As of `waypoints`.

    References
    ----------
    [Flash1985]_ for the time law.
    """

    side = Side.SOURCE
    uses_robot = True
    inputs = (TIME,)
    outputs = (Output("q_d", "n", "rad"), Output("x_d", "m", "m"))

    times: Vector = Real("*", "s", spread=False)
    q_d: Table = Rows("n", "rad")
    dq_d: Table | None = Rows("n", "rad/s", default=None)
    ddq_d: Table | None = Rows("n", "rad/s^2", default=None)
    after: Literal["stays", "repeats", "returns"] = "stays"

    @model_validator(mode="after")
    def _one_path(self) -> JointWaypoints:
        if len(self.q_d) != len(self.times) or len(self.q_d) < 2:
            found = f"{len(self.q_d)} and {len(self.times)}"
            raise ValueError(f"expected as many points as times and at least 2, found {found}")
        if any(later <= earlier for earlier, later in pairwise(self.times)):
            raise ValueError(f"expected increasing times, found {list(self.times)}")
        check_rates(self, "q_d", "x_d")
        return self

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        times = ca.vertsplit(p.times)
        q_d = through(p, "q_d", path_time(self, u.t, times), times)
        return Equations(outputs={"q_d": q_d, "x_d": p.robot.position(q_d)})
