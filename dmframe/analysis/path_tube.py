r"""That an exact joint path lies close to the lines between poses, over every interval of time: nothing is sampled.

Between two poses let l(t) be the line, v its velocity and :math:`t_m` the middle of the time. A pose l(t) + d puts the
tool on its path where

.. math:: F(t, d) = \begin{pmatrix} f(l(t) + d) - x_d(t) \\ N^\top d \end{pmatrix} = 0

with the rows of N the directions in which the tool rests at :math:`t_m`; a robot that is not redundant has none. With X
near the inverse of the Jacobian A of F in d, and A enclosed over a box of half-width r about the line, Krawczyk's test

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

SHARE: Final = 0.1
"""Largest distance of the exact joint path from the lines between poses, as a fraction of the tube."""

LEAST: Final = 1e-4
"""Where the tube is narrower, this [rad]."""

_SMALLER: Final = 8.0
_SMALLEST: Final = 1e-5
"""Boxes are made smaller by that factor, and not below this half-width [rad]."""

_CLOSE: Final = 0.5
"""Where |I - X A| is below this, a smaller box would not help: the interval of time is too long."""

_SEAM: Final = 0.9
"""What is proved lies this far inside the box of the next interval: where two meet, both have the same pose."""


@final
@dataclass(frozen=True)
class Apart:
    """What is certain over intervals of time.

    Parameters
    ----------
    most
        (N, n) the exact joint path lies within this of the line, in each joint; not a number where that is not proved.
    reason
        Why it is not, of the first interval where it is not.
    """

    most: Array
    reason: str

    @property
    def proved(self) -> NDArray[np.bool_]:
        """(N,) where it is proved."""
        return np.asarray(np.isfinite(self.most).all(axis=1))


@final
class PathTube:
    """Krawczyk's test for one path of the tool.

    Parameters
    ----------
    actual, q
        f, SX (m,), of the pose q and `p` alone.
    desired, time
        :math:`x_d`, SX (m,), of the time and `p` alone.
    p, values
        The parameters, and each element as a number or an enclosure.
    limit
        r [rad].

    Raises
    ------
    ValueFault
        An operation of which no enclosure is known.
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

    def over(self, first: Array, last: Array, begin: Array, end: Array) -> Apart:
        """The test for lines from `first` to `last` (N, n), over the times from `begin` to `end` (N,).

        Where the Jacobian varies too much over the box, a smaller box may do: near a singularity, for example.
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
        return Apart(most, reason)

    def _within(self, limit: float, first: Array, last: Array, begin: Array, end: Array) -> tuple[Array, str, bool]:
        """The test with boxes of that half-width; why it fails; and whether it does since they are too wide."""
        q, t = (first + last).T / 2, np.clip((begin + end) / 2, begin, end)
        v = (last - first).T / np.where(end > begin, end - begin, 1.0)
        passed = Enclosure(down(begin - t), up(end - t))
        with np.errstate(all="ignore"):  # where a number is none, nothing is proved
            line = Enclosure.of(q) + Enclosure.of(v) * passed
            slack = self._slack(first.T, last.T, q, v, begin - t, end - t)
            box = Enclosure(down(line.lower - limit), up(line.upper + limit))
            J = self._matrix(self._slope, box, self.n)
            missed, jumps = self._missed(q, t, v, Enclosure(begin, end), passed, J)
            X, still = self._inverse(J)
            A = Enclosure(np.concatenate([J.lower, still]), np.concatenate([J.upper, still]))
            doubt = (_product(X, A) - np.eye(self.n)[:, :, None]).magnitude
            step = _product(X[:, : self.m], Enclosure(missed.lower[:, None], missed.upper[:, None])).magnitude[:, 0]
            within = up(step + _row_sums(doubt * limit))
            sharp = up(step + _row_sums(up(doubt * within)))
            good = (within < _SEAM * limit).all(axis=0)
            found = np.where(good, up(sharp + slack), np.nan).T
            close = np.max(_row_sums(doubt), axis=0) < _CLOSE
        if good.all():
            return found, "", False
        return found, self._reason(int(np.argmin(good)), jumps, doubt), bool((~good & ~close & ~jumps).any())

    def _slack(self, first: Array, last: Array, q: Array, v: Array, before: Array, after: Array) -> Array:
        """By how much rounding lets the line miss its ends."""
        ends = zip((first, last), (before, after), strict=True)
        missed = [(Enclosure.of(q) + Enclosure.of(v) * Enclosure(down(s), up(s)) - pose).magnitude for pose, s in ends]
        return np.asarray(np.maximum(*missed))

    def _missed(
        self, q: Array, t: Array, v: Array, instants: Enclosure, passed: Enclosure, J: Enclosure
    ) -> tuple[Enclosure, NDArray[np.bool_]]:
        """F(t, 0), (m, N), over each interval; and where the desired path may jump."""
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
        """X (n, n, N), and the rows of N (n - m, n, N), in floating point: any will do."""
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

    def _reason(self, place: int, jumps: NDArray[np.bool_], doubt: Array) -> str:
        if jumps[place]:
            return "the desired path may jump there"
        if not np.max(doubt[:, :, place].sum(axis=1)) < 1:
            return "the tool's Jacobian is too near to rank loss there"
        return "the desired path could not be enclosed there"


def path_tube(path: tuple[Any, ...], tube: float) -> PathTube | str:
    """The test of a path, (f, q, x_d, t, p, values), in a tube of that half-width [rad]; or why there is none."""
    actual, q, desired, time, p, values = path
    try:
        return PathTube(actual, q, desired, time, p, values, max(SHARE * tube, LEAST))
    except ValueFault as fault:
        return fault.text


def _stacked(elements: Sequence[Enclosure], shape: tuple[int, ...]) -> Enclosure:
    """Elements as the rows of one enclosure."""
    lower = np.stack([np.broadcast_to(element.lower, shape) for element in elements])
    return Enclosure(lower, np.stack([np.broadcast_to(element.upper, shape) for element in elements]))


def _product(X: Array, A: Enclosure) -> Enclosure:
    """X (n, k, N) times A (k, l, N)."""
    turned = Enclosure(A.lower.swapaxes(0, 1)[None], A.upper.swapaxes(0, 1)[None])
    found = times(turned, X.swapaxes(0, 1))
    return Enclosure(found.lower[0].swapaxes(0, 1), found.upper[0].swapaxes(0, 1))


def _row_sums(parts: Array) -> Array:
    """Upper bounds of the sums of rows, (n, k, N) or, times a column (k, N), the same."""
    total = np.zeros((parts.shape[0], parts.shape[2]))
    for j in range(parts.shape[1]):
        total = up(total + up(parts[:, j]))
    return total


__all__ = ["LEAST", "SHARE", "Apart", "PathTube", "path_tube"]
