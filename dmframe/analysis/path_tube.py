r"""Proof that an exact joint path is close to the lines between poses, over whole time intervals (no sampling).

Between two poses let l(t) be the line, v its velocity and :math:`t_m` the middle of the interval. A pose l(t) + d puts
the tool on its path if
tool on its path where

.. math:: F(t, d) = \begin{pmatrix} f(l(t) + d) - x_d(t) \\ N^\top d \end{pmatrix} = 0

with the rows of N a basis of the null space of the Jacobian at :math:`t_m`; a robot that is not redundant has none.
With X near the inverse of the Jacobian A of F in d, and A enclosed over a box of half-width r about the line,
Krawczyk's test

.. math:: |X F(t, 0)| + |I - X A|\, r < r

proves, for every t of the interval, that there is exactly one such d in the box [Rump2010]_. The first term is enclosed
twice: over the ranges of f and :math:`x_d`, and by the mean value theorem from :math:`t_m`, where :math:`x_d` has no
jump in the interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dmframe.analysis.rank_bound import times
from dmframe.common.errors import ValueFault
from dmframe.exact.enclosure import RULES, Enclosing, Enclosure, down, up
from dmframe.exact.switching import SWITCHING, over_pieces

Array = NDArray[np.float64]

TUBE_FRACTION: Final = 0.1
"""Largest distance of the exact joint path from the lines between poses, as a fraction of the tube."""

LEAST: Final = 1e-4
"""Least value of that distance [rad], for a narrow tube."""

_SMALLER: Final = 8.0
_SMALLEST: Final = 1e-5
"""Factor by which boxes are reduced, and their least half-width [rad]."""

_CLOSE: Final = 0.5
"""If |I - X A| is below this, a smaller box would not help: the time interval is too long."""

_SEAM: Final = 0.9
"""Fraction of a box within which the proved pose lies, so that adjacent intervals share the pose at their boundary."""


@final
@dataclass(frozen=True)
class LineDistance:
    """Proved distance bounds over time intervals.

    Parameters
    ----------
    most
        (N, n) bound on the distance of the exact joint path from the line, by joint; NaN if not proved.
    reason
        Reason for the first interval without a proof.
    """

    most: Array
    reason: str

    @property
    def proved(self) -> NDArray[np.bool_]:
        """(N,) True for proved intervals."""
        return np.asarray(np.isfinite(self.most).all(axis=1))


@final
class PathTube:
    """Krawczyk's test for one path of the tool.

    Parameters
    ----------
    actual, q
        f, SX (m,), a function of the pose q and `p` only.
    desired, time
        :math:`x_d`, SX (m,), a function of time and `p` only.
    p, values
        The parameters, and each element as a number or an enclosure.
    limit
        r [rad].

    Raises
    ------
    ValueFault
        An operation has no enclosure.
    """

    def __init__(self, actual: Any, q: Any, desired: Any, time: Any, p: Any, values: Sequence[Any], limit: float):
        self.n, self.m, self.limit = int(q.numel()), int(actual.numel()), limit
        self._p = list(values)

        def enclosed(name: str, arguments: list[Any], value: Any, rules: Any) -> Enclosing:
            return Enclosing(ca.Function(name, arguments, [ca.cse(ca.densify(ca.vec(value)))]), rules)

        actual, desired = ca.vec(actual), ca.vec(desired)
        self._actual = enclosed("position", [q, p], actual, RULES)
        self._slope = enclosed("jacobian", [q, p], ca.jacobian(actual, q), RULES)
        self._desired = enclosed("path", [time, p], desired, SWITCHING)
        self._speed = enclosed("velocity", [time, p], ca.jacobian(desired, time), SWITCHING)

    def over(self, first: Array, last: Array, begin: Array, end: Array) -> LineDistance:
        """Krawczyk's test for lines from `first` to `last` (N, n), over the times from `begin` to `end` (N,).

        If the Jacobian varies too much over the box, smaller boxes are tried, for example near a singularity.
        """
        most, reason, limit = np.full(first.shape, np.nan), "", self.limit
        open_ones = np.arange(len(first))
        while len(open_ones):
            found, reason, wide = self._within(limit, *(part[open_ones] for part in (first, last, begin, end)))
            most[open_ones] = found
            limit /= _SMALLER
            if limit < _SMALLEST or not wide:
                break
            open_ones = open_ones[np.isnan(found).any(axis=1)]
        return LineDistance(most, reason)

    def _within(self, limit: float, first: Array, last: Array, begin: Array, end: Array) -> tuple[Array, str, bool]:
        """Test with boxes of that half-width; the reason of a failure; and whether the boxes are too wide."""
        q, t = (first + last).T / 2, np.clip((begin + end) / 2, begin, end)
        v = (last - first).T / np.where(end > begin, end - begin, 1.0)
        passed = Enclosure(down(begin - t), up(end - t))
        with np.errstate(all="ignore"):  # NaN: not proved
            line = Enclosure.of(q) + Enclosure.of(v) * passed
            slack = self._slack(first.T, last.T, q, v, begin - t, end - t)
            box = Enclosure(down(line.lower - limit), up(line.upper + limit))
            J = self._matrix(self._slope, box, self.n)
            missed, jumps = self._missed(q, t, v, Enclosure(begin, end), passed, J)
            X, still = self._inverse(J)
            A = Enclosure(np.concatenate([J.lower, still]), np.concatenate([J.upper, still]))
            contraction = (_product(X, A) - np.eye(self.n)[:, :, None]).magnitude
            step = _product(X[:, : self.m], Enclosure(missed.lower[:, None], missed.upper[:, None])).magnitude[:, 0]
            within = up(step + _row_sums(contraction * limit))
            sharp = up(step + _row_sums(up(contraction * within)))
            good = (within < _SEAM * limit).all(axis=0)
            found = np.where(good, up(sharp + slack), np.nan).T
            close = np.max(_row_sums(contraction), axis=0) < _CLOSE
        if good.all():
            return found, "", False
        return found, self._reason(int(np.argmin(good)), jumps, contraction), bool((~good & ~close & ~jumps).any())

    def _slack(self, first: Array, last: Array, q: Array, v: Array, before: Array, after: Array) -> Array:
        """Rounding error of the line at its ends."""
        ends = zip((first, last), (before, after), strict=True)
        missed = [(Enclosure.of(q) + Enclosure.of(v) * Enclosure(down(s), up(s)) - pose).magnitude for pose, s in ends]
        return np.asarray(np.maximum(*missed))

    def _missed(
        self, q: Array, t: Array, v: Array, instants: Enclosure, passed: Enclosure, J: Enclosure
    ) -> tuple[Enclosure, NDArray[np.bool_]]:
        """F(t, 0), (m, N), over each interval; and intervals in which the desired path may jump."""
        here = self._column(self._actual, list(q))
        goals, jumps = over_pieces(self._desired, [[instants], self._p], t.shape)
        moved = times(Enclosure(J.lower[None], J.upper[None]), v[:, None])
        moved = Enclosure(moved.lower[0, :, 0], moved.upper[0, :, 0])
        plain = here + moved * passed - _stacked(goals, t.shape)
        speed = _stacked(self._speed([[instants], self._p])[0], t.shape)
        sharp = here - self._column(self._desired, [t]) + (moved - speed) * passed
        sure = ~jumps & np.isfinite(sharp.lower + sharp.upper)
        lower = np.where(sure, np.maximum(plain.lower, sharp.lower), plain.lower)
        return Enclosure(lower, np.where(sure, np.minimum(plain.upper, sharp.upper), plain.upper)), jumps

    def _inverse(self, J: Enclosure) -> tuple[Array, Array]:
        """X (n, n, N), and the rows of N (n - m, n, N), in floating point; the proof holds for any X and N."""
        middle = np.nan_to_num((J.lower + J.upper).transpose(2, 0, 1) / 2)
        _, s, Vt = np.linalg.svd(middle)
        still = Vt[:, self.m :]
        joined = np.concatenate([middle, still], axis=1)
        regular = s[:, -1] > 0 if self.m <= self.n else np.zeros(len(s), dtype=bool)
        X = np.full((len(s), self.n, self.n), np.nan)
        if regular.any():
            X[regular] = np.linalg.pinv(joined[regular])
        return np.moveaxis(X, 0, 2), np.moveaxis(still, 0, 2)

    def _column(self, f: Enclosing, arguments: list[Any]) -> Enclosure:
        return _stacked(f([arguments, self._p])[0], np.shape(arguments[0]))

    def _matrix(self, f: Enclosing, box: Enclosure, columns: int) -> Enclosure:
        inside = [Enclosure(*ends) for ends in zip(box.lower, box.upper, strict=True)]
        found = _stacked(f([inside, self._p])[0], box.lower.shape[1:])
        shape = columns, self.m, box.lower.shape[1]
        return Enclosure(found.lower.reshape(shape).swapaxes(0, 1), found.upper.reshape(shape).swapaxes(0, 1))

    def _reason(self, place: int, jumps: NDArray[np.bool_], contraction: Array) -> str:
        if jumps[place]:
            return "the desired path may be discontinuous there"
        if not np.max(contraction[:, :, place].sum(axis=1)) < 1:
            return "the tool's Jacobian is nearly rank-deficient there"
        return "the desired path could not be enclosed there"


def path_tube(path: tuple[Any, ...], tube: float) -> PathTube | str:
    """Krawczyk's test of a path (f, q, x_d, t, p, values) in a tube of that half-width [rad], or why there is none."""
    actual, q, desired, time, p, values = path
    try:
        return PathTube(actual, q, desired, time, p, values, max(TUBE_FRACTION * tube, LEAST))
    except ValueFault as fault:
        return fault.text


def _stacked(elements: Sequence[Enclosure], shape: tuple[int, ...]) -> Enclosure:
    """Stack elements as rows of one enclosure."""
    lower = np.stack([np.broadcast_to(element.lower, shape) for element in elements])
    return Enclosure(lower, np.stack([np.broadcast_to(element.upper, shape) for element in elements]))


def _product(X: Array, A: Enclosure) -> Enclosure:
    """X (n, k, N) times A (k, l, N)."""
    turned = Enclosure(A.lower.swapaxes(0, 1)[None], A.upper.swapaxes(0, 1)[None])
    found = times(turned, X.swapaxes(0, 1))
    return Enclosure(found.lower[0].swapaxes(0, 1), found.upper[0].swapaxes(0, 1))


def _row_sums(parts: Array) -> Array:
    """Upper bounds of row sums, (n, k, N); for a column (k, N), the same."""
    total = np.zeros((parts.shape[0], parts.shape[2]))
    for j in range(parts.shape[1]):
        total = up(total + up(parts[:, j]))
    return total


__all__ = ["LEAST", "TUBE_FRACTION", "LineDistance", "PathTube", "path_tube"]
