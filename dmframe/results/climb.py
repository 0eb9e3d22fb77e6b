"""How far V rose along a run, beyond what rounding explains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np


@final
@dataclass(frozen=True)
class Climb:
    """The largest rise of V above a value that it had before, and the fall with which it is compared.

    Parameters
    ----------
    start, end, least
        V at the first and the last instant, and its least value.
    rise
        The largest V(t) - V(s) over all s < t; 0 where that is within rounding.
    since, until
        s and t [s]; None where V never rose.
    rises
        From how many instants to the next V rose by more than rounding explains.
    steps
        Pairs of neighbouring instants.
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
        """How far V came below its first value."""
        return self.start - self.least

    @property
    def share(self) -> float | None:
        """The rise as a share of the fall; None where V never fell."""
        return self.rise / self.fall if self.fall > 0 else None


def climb_of(time: np.ndarray, V: np.ndarray, rounding: np.ndarray) -> Climb:
    """The climb of V over the instants `time`, up to where V is no longer finite.

    Parameters
    ----------
    V
        (N,), without the jumps that sources cause.
    rounding
        (N,), how far each value may be wrong; empty for exact values.
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
