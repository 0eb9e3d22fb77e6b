"""Path through points, at rest in each or with given velocities."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Literal, final

import casadi as ca
from pydantic import model_validator

from dmframe.block import (
    SX,
    TIME,
    AbstractBlock,
    Equations,
    Output,
    Real,
    Rows,
    Side,
    Signals,
    Table,
    Vector,
    operation,
)
from dmframe_blocks._quaternions import partly, quaternion, turned


@final
class Waypoints(AbstractBlock):
    r"""Path through points, at rest in each, or with given velocities and accelerations.

    With the completed fraction :math:`s(\tau) = 10 \tau^3 - 15 \tau^4 + 6 \tau^5` of each segment, where :math:`\tau`
    is the elapsed fraction of its time, 0 before it begins and 1 after it ends,

    .. math::

        x_d = \sum_i (s_{i-1} - s_i) \left(x_i + v_i (t - t_i) + \tfrac12 a_i (t - t_i)^2\right)

    with 1 in place of s before the first point and 0 in place of that after the last one. The path meets each point
    with its velocity and acceleration, is twice continuously differentiable, and stays at the last point. At rest in
    each point its segments are straight minimum-jerk motions. With `orientations` the tool rotates on each segment
    about one axis along the shortest rotation, with the same completed fraction.

    ``dmframe path FILE ROBOT`` writes this block from a CSV file or a ROS ``JointTrajectory``.

    Parameters
    ----------
    times : list, s
        Increasing times at which the points are reached.
    x_d : one row a time, (m,), m
        Points of the tool. Set `x_d` or `q_d`.
    dx_d, ddx_d : one row a time, (m,)
        Velocities and accelerations there; by default zero. Those of the first and of the last point have to be zero.
    q_d : one row a time, (n,), rad
        Points of the joints.
    dq_d, ddq_d : one row a time, (n,)
        Velocities and accelerations there, as for the tool.
    after : stays, repeats or returns
        What the path does after its last point: it stays there, begins again, for which the last point has to be the
        first one, or goes back on the same way and begins again.
    orientations : one row a time, (3,), rad
        Orientations of the tool in the base frame as rotation vectors, axis times angle; none by default.

    References
    ----------
    [Flash1985]_ for s; [Shoemake1985]_ for shortest rotations.
    """

    side = Side.SOURCE
    inputs = (TIME,)
    outputs = (
        Output("x_d", "m", "m", optional=True),
        Output("q_d", "n", "rad", optional=True),
        Output("p_d", "4", optional=True),
    )

    times: Vector = Real("*", "s", spread=False)
    x_d: Table | None = Rows("m", "m", default=None)
    dx_d: Table | None = Rows("m", "m/s", default=None)
    ddx_d: Table | None = Rows("m", "m/s^2", default=None)
    q_d: Table | None = Rows("n", "rad", default=None)
    dq_d: Table | None = Rows("n", "rad/s", default=None)
    ddq_d: Table | None = Rows("n", "rad/s^2", default=None)
    after: Literal["stays", "repeats", "returns"] = "stays"
    orientations: Table | None = Rows("3", "rad", default=None)

    @model_validator(mode="after")
    def _one_path(self) -> Waypoints:
        if (self.x_d is None) == (self.q_d is None):
            raise ValueError("expected one of x_d and q_d, found " + ("neither" if self.x_d is None else "both"))
        points = self.x_d or self.q_d or ()
        if len(points) != len(self.times) or len(points) < 2:
            found = f"{len(points)} and {len(self.times)}"
            raise ValueError(f"expected as many points as times and at least 2, found {found}")
        if self.orientations is not None and len(self.orientations) != len(points):
            found = f"{len(self.orientations)} and {len(points)}"
            raise ValueError(f"expected as many orientations as times, found {found}")
        if any(later <= earlier for earlier, later in pairwise(self.times)):
            raise ValueError(f"expected increasing times, found {list(self.times)}")
        check_rates(self, "x_d" if self.q_d is None else "q_d", "q_d" if self.q_d is None else "x_d")
        return self

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """A sum over the points, and a product of the rotations of the segments."""
        name, times = "x_d" if "x_d" in p else "q_d", ca.vertsplit(p.times)
        t = path_time(self, u.t, times)
        outputs = {name: through(p, name, t, times)}
        if "orientations" not in p:
            return Equations(outputs=outputs)
        ends_of_legs = [quaternion(row.T) for row in ca.vertsplit(p.orientations)]
        p_d = ends_of_legs[0]
        for (start, end), (begins, ends) in zip(pairwise(ends_of_legs), pairwise(times), strict=True):
            p_d = turned(p_d, partly(start, end, behind(t, begins, ends)))
        return Equations(outputs={**outputs, "p_d": p_d})


def check_rates(block: Any, name: str, other: str) -> None:
    """Raise ValueError for velocities or accelerations that do not fit the points `name` of a block."""
    points = getattr(block, name)
    for rate in ("d", "dd"):
        if getattr(block, f"{rate}{other}", None) is not None:
            raise ValueError(f"expected {rate}{name} with {name}, found {rate}{other}")
        rows = getattr(block, f"{rate}{name}")
        if rows is None:
            continue
        if len(rows) != len(points):
            raise ValueError(f"expected as many rows of {rate}{name} as times, found {len(rows)} and {len(points)}")
        if any(rows[0] + rows[-1]):
            raise ValueError(f"expected {rate}{name} of zero at the first and the last point, where the path rests")
    if block.after == "repeats" and points[0] != points[-1]:
        raise ValueError("expected the last point to be the first one, since the path repeats")


def through(p: Signals, name: str, t: SX, times: Sequence[SX]) -> SX:
    """The path through the points `name`, with their rates."""
    points = [ca.vertsplit(getattr(p, rate + name)) if rate + name in p else None for rate in ("", "d", "dd")]
    steps = [behind(t, *ends) for ends in pairwise(times)]
    if points[1] is None and points[2] is None:
        x = points[0] or []
        return sum(((end - start).T * step for (start, end), step in zip(pairwise(x), steps, strict=True)), x[0].T)
    found, weights = 0, [1, *steps, 0]
    for k, (at, (before, after)) in enumerate(zip(times, pairwise(weights), strict=True)):
        near, since = 0, t - at
        for rows, power in zip(points, (1, since, since * since / 2), strict=True):
            near = near if rows is None else near + rows[k].T * power
        found = found + (before - after) * near
    return found


def path_time(block: Any, t: SX, times: Sequence[SX]) -> SX:
    """The time on a path that repeats or returns."""
    if block.after == "stays":
        return t
    first, last = times[0], times[-1]
    passes = ca.fmax(t - first, 0) / (last - first)
    if block.after == "repeats":
        return first + (last - first) * again(passes)
    return first + (last - first) * back(passes)


@operation
def again(passes: Any) -> Any:
    """The completed fraction of a pass, 0 to 1, that begins again."""
    return passes - ca.floor(passes)


@operation
def back(passes: Any) -> Any:
    """The completed fraction of a way, which increases from 0 to 1 and then decreases to 0."""
    half = passes / 2
    return 1 - ca.fabs(1 - 2 * (half - ca.floor(half)))


@operation
def behind(t: Any, begins: Any, ends: Any) -> Any:
    """The completed fraction of a segment, 10 s^3 - 15 s^4 + 6 s^5, with s the elapsed fraction of its time."""
    tau = ca.fmin(ca.fmax((t - begins) / (ends - begins), 0), 1)
    return tau * tau * tau * (10 + tau * (6 * tau - 15))
