"""Rise of V along a run, beyond its rounding error."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import final

import numpy as np


@final
@dataclass(frozen=True)
class Climb:
    """Largest rise of V above an earlier value, and the fall of V for comparison.

    Parameters
    ----------
    start, end, least
        V at the first and the last instant, and its minimum.
    rise
        Largest V(t) - V(s) over all s < t; 0 if within rounding.
    since, until
        s and t [s]; None if V never rose.
    rises
        Number of intervals over which V rose by more than its rounding error.
    steps
        Number of intervals.
    """

    start: float
    end: float
    least: float
    rise: float
    since: float | None
    until: float | None
    rises: int
    steps: int

    @property
    def fall(self) -> float:
        """Difference of the first value and the minimum of V."""
        return self.start - self.least

    @property
    def fraction(self) -> float | None:
        """Rise as a fraction of the fall; None if V never fell."""
        return self.rise / self.fall if self.fall > 0 else None

    @property
    def share(self) -> float | None:
        """Former name of `fraction`."""
        warnings.warn("Climb: share is now fraction", DeprecationWarning, stacklevel=2)
        return self.fraction


def climb_of(time: np.ndarray, V: np.ndarray, rounding: np.ndarray) -> Climb:
    """Compute the climb of V over the instants `time`, up to the first non-finite value.

    Parameters
    ----------
    V
        (N,), without jumps caused by sources.
    rounding
        (N,), bound on the error of each value; empty for exact values.
    """
    finite = np.isfinite(V)
    count = V.size if finite.all() else int(np.argmin(finite))
    if not count:
        return Climb(np.nan, np.nan, np.nan, 0.0, None, None, 0, 0)
    V, wrong = V[:count], (rounding[:count] if rounding.size else np.zeros(count))
    rises = int(np.count_nonzero(np.diff(V) > wrong[1:] + wrong[:-1]))
    above = V - np.minimum.accumulate(V)
    until = int(np.argmax(above))
    since = int(np.argmin(V[: until + 1]))
    start, end, least = float(V[0]), float(V[-1]), float(V.min())
    if not above[until] > wrong[until] + wrong[since]:
        return Climb(start, end, least, 0.0, None, None, rises, count - 1)
    return Climb(
        start, end, least, float(above[until]), float(time[since]), float(time[until]), rises, count - 1
    )  # fmt: skip
