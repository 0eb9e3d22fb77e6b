"""Path through points, at rest in each."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, final

import casadi as ca
from pydantic import model_validator

from dmframe.block import (
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
    r"""Straight segments between points, each a minimum-jerk motion from rest to rest.

    The completed fraction of each segment is :math:`s(\tau) = 10 \tau^3 - 15 \tau^4 + 6 \tau^5`, with :math:`\tau` the
    elapsed fraction of its time: 0 before it begins, 1 after it ends.

    The path is twice continuously differentiable and stays at the last point. With `orientations` the tool rotates on
    each segment about one axis along the shortest rotation, with the same completed fraction.

    Parameters
    ----------
    times : list, s
        Increasing times at which the points are reached.
    x_d : one row a time, (m,), m
        Points of the tool. Set `x_d` or `q_d`.
    q_d : one row a time, (n,), rad
        Points of the joints.
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
    q_d: Table | None = Rows("n", "rad", default=None)
    orientations: Table | None = Rows("3", "rad", default=None)

    @model_validator(mode="after")
    def _one_path(self) -> Waypoints:
        if (self.x_d is None) == (self.q_d is None):
            raise ValueError("expected one of x_d and q_d, found " + ("neither" if self.x_d is None else "both"))
        rows = len(self.x_d or self.q_d or ())
        if rows != len(self.times) or rows < 2:
            raise ValueError(f"expected as many points as times and at least 2, found {rows} and {len(self.times)}")
        if self.orientations is not None and len(self.orientations) != rows:
            raise ValueError(f"expected as many orientations as times, found {len(self.orientations)} and {rows}")
        if any(later <= earlier for earlier, later in pairwise(self.times)):
            raise ValueError(f"expected increasing times, found {list(self.times)}")
        return self

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """A sum over the segments, and a product of their rotations."""
        name = "x_d" if "x_d" in p else "q_d"
        points, times = ca.vertsplit(getattr(p, name)), ca.vertsplit(p.times)
        desired = points[0].T
        for (start, end), (begins, ends) in zip(pairwise(points), pairwise(times), strict=True):
            desired += (end - start).T * behind(u.t, begins, ends)
        if "orientations" not in p:
            return Equations(outputs={name: desired})
        ends_of_legs = [quaternion(row.T) for row in ca.vertsplit(p.orientations)]
        p_d = ends_of_legs[0]
        for (start, end), (begins, ends) in zip(pairwise(ends_of_legs), pairwise(times), strict=True):
            p_d = turned(p_d, partly(start, end, behind(u.t, begins, ends)))
        return Equations(outputs={name: desired, "p_d": p_d})


@operation
def behind(t: Any, begins: Any, ends: Any) -> Any:
    """The completed fraction of a segment, 10 s^3 - 15 s^4 + 6 s^5, with s the elapsed fraction of its time."""
    tau = ca.fmin(ca.fmax((t - begins) / (ends - begins), 0), 1)
    return tau * tau * tau * (10 + tau * (6 * tau - 15))
