"""Search for the largest set of parameters for which a rank bound is proved along a joint path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from dmframe.analysis.joint_path import JointPath
from dmframe.analysis.rank_bound import MatrixBound, Shape
from dmframe.analysis.rank_loss import Witness, witness
from dmframe.analysis.rank_problem import RankProblem
from dmframe.exact.enclosure import down, up

Array = NDArray[np.float64]
Progress = Callable[[str], None]

RESOLUTION: Final = 0.01
"""Relative accuracy of a radius."""

_SMALLEST: Final = 1e-6
"""Smallest radius; smaller ones count as none [m]."""

LARGEST: Final = 10.0
"""Largest radius of the search [m]."""


@final
@dataclass(frozen=True)
class Cover:
    """Boxes of poses, (N, n) from `low` to `high`, that together contain the tube.

    Parameters
    ----------
    segment
        (N,) index of the path segment of each box.
    least
        (N,) certified least singular value over each box; below the required one in a failed cover.
    """

    low: Array
    high: Array
    segment: NDArray[np.intp]
    least: Array

    def among(self, chosen: NDArray[np.bool_]) -> Cover:
        """Selected boxes."""
        return Cover(self.low[chosen], self.high[chosen], self.segment[chosen], self.least[chosen])

    @staticmethod
    def joined(parts: list[Cover]) -> Cover:
        """Concatenation of several covers."""
        names = ("low", "high", "segment", "least")
        return Cover(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


@final
class RankSearch:
    """Search over the size of the set for one path, tube and shape.

    Parameters
    ----------
    weights
        (h,) half-widths of the set of radius 1.
    most
        Maximum number of boxes for one radius.
    """

    def __init__(
        self,
        problem: RankProblem,
        path: JointPath,
        tube: float,
        shape: Shape,
        weights: Array,
        most: int,
        tell: Progress,
    ) -> None:
        self.problem, self.path, self.tube, self.shape, self.most = problem, path, tube, shape, most
        self.bound = MatrixBound(problem.expression, problem.q, problem.a, problem.p, problem.enclosed)
        self._weights, self._progress = weights, tell

    def singular(self, q: Array) -> Array:
        """Least singular value at each pose (N, n), with the parameters at the centre; in floating point."""
        centre = np.tile(self.problem.centre, (len(q), 1))
        found = self.bound.value(q.T, centre.T, self.problem.values).full()
        return np.asarray(np.linalg.svd(found.T.reshape(len(q), self.bound.columns, -1), compute_uv=False)[:, -1])

    def witness(self, radius: float, least: float) -> Witness | None:
        """See `dmframe.analysis.rank_loss.witness`."""
        problem = self.problem
        half = radius * self._weights
        return witness(self.bound, problem.values, self.path.poses, self.tube, problem.centre, half, self.shape, least)

    def segments(self) -> Cover:
        """Box around each segment of the path, enlarged by the tube and the distance bound of the exact path."""
        low, high = self.path.hulls
        wide = self.tube if self.path.line_distance is None else up(self.tube + self.path.line_distance)
        low, high = down(low - wide), up(high + wide)
        return Cover(low, high, np.arange(len(low)), np.full(len(low), -np.inf))

    def cover(self, radius: float, least: float, begin: Cover) -> tuple[bool, Cover]:
        """Bisect boxes until each certifies `least`; returns False and the others on failure.

        It stops at a box that would fail even as a point, and at the maximum number of boxes.
        """
        done, open_boxes, count = list[Cover](), begin, 0
        while len(open_boxes.low):
            count += len(open_boxes.low)
            self._progress(f"radius {radius * 1e3:.4g} mm: {count} boxes")
            found, contribution = self._certified(open_boxes, radius)
            good = found.least >= least
            done.append(found.among(good))
            open_boxes, contribution = found.among(~good), contribution[~good]
            if not len(open_boxes.low):
                break
            middle = (open_boxes.low + open_boxes.high) / 2
            points = Cover(middle, middle, open_boxes.segment, open_boxes.least)
            at_points, _ = self._certified(points, radius)
            if not (at_points.least >= least).all() or count > self.most:
                return False, open_boxes
            open_boxes = _halved(open_boxes, contribution)
        return True, Cover.joined(done)

    def largest(self, least: float, begin: Cover, ceiling: float) -> tuple[float, Cover]:
        """Largest radius found below `ceiling`, and its cover; `begin` is a cover for radius 0."""
        low, high, cover = 0.0, ceiling, begin
        while high - low > max(RESOLUTION * high, _SMALLEST):
            radius = (low + high) / 2
            holds, found = self.cover(radius, least, cover)
            if holds:
                low, cover = radius, found
            else:
                high = radius
        return low, cover

    def fails_at(self, least: float) -> float | None:
        """Smallest radius found with a counterexample; None if there is none up to the largest radius."""
        low, high = 0.0, _SMALLEST
        while self.witness(high, least) is None:
            low, high = high, 2 * high
            if high > LARGEST:
                return None
        while high - low > RESOLUTION / 4 * high:
            radius = (low + high) / 2
            low, high = (low, radius) if self.witness(radius, least) else (radius, high)
        return high

    def _certified(self, boxes: Cover, radius: float) -> tuple[Cover, Array]:
        half = up(radius * self._weights)
        bound = self.bound.over(boxes.low, boxes.high, self.problem.centre, half, self.shape)
        return Cover(boxes.low, boxes.high, boxes.segment, bound.least), bound.contribution


def _halved(boxes: Cover, contribution: Array) -> Cover:
    """Bisect each box across the joint whose width contributes most to the uncertainty."""
    rows, joint = np.arange(len(contribution)), np.argmax(np.nan_to_num(contribution), axis=1)
    middle = (boxes.low[rows, joint] + boxes.high[rows, joint]) / 2
    low, high = boxes.low.copy(), boxes.high.copy()
    low[rows, joint], high[rows, joint] = middle, middle
    left, right = Cover(boxes.low, high, boxes.segment, boxes.least), Cover(low, boxes.high, boxes.segment, boxes.least)
    return Cover.joined([left, right])
