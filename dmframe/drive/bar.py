"""What a controller must reach by itself in a rehearsal, however small the change that a condition makes.

A tolerance that the graph states, and that a robot which holds still does not meet; without one, at most half the
error of a robot that holds still, and no larger an error than the kinematic inverse of J under the same condition. So
it is in the last quarter of a run. In the second and the third the error is at most half of what holding still makes
of the path, or within the tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from dmframe.units import plain

STILL_SHARE: Final = 0.5
"""Of the error of holding still: a controller that leaves more than that does not follow. A rule of thumb."""
RESOLUTION: Final = 1e-5
"""Differences of errors below it mean nothing: arms tell their joints and tools no better [m, rad]."""


@final
@dataclass(frozen=True)
class Measured:
    """The errors of one run, root mean square.

    Parameters
    ----------
    signal, unit
        Of the error.
    second, third, last
        In quarters of the run.
    still
        In the last quarter, of a robot that stays at its start.
    stopped
        Why it did not come to its end; empty where it did.
    moved
        In the quarter in which holding still errs most, the first left out.
    """

    signal: str
    unit: str
    second: float
    third: float
    last: float
    still: float
    stopped: str
    moved: float = 0.0

    @property
    def follows(self) -> bool:
        """True where it came to its end with at most half the error of holding still."""
        return not self.stopped and self.last <= STILL_SHARE * self.still

    @property
    def farthest(self) -> float:
        """What holding still errs by where it errs most."""
        return max(self.still, self.moved)


@final
@dataclass(frozen=True)
class Bar:
    """What the errors are compared with.

    Parameters
    ----------
    tolerance
        Of the graph, in the unit of its error; None without one.
    rival
        What the rival is called; empty where there is no fair one.
    lacking
        Why there is none.
    """

    tolerance: float | None = None
    rival: str = ""
    lacking: str = ""

    def above(self, run: Measured, rival: Measured | None, *, ideal: bool) -> str:
        """Why an error is too large; empty where it is not.

        The rival's margin is how much its own error changes from the third quarter to the last, `RESOLUTION` at least.
        """
        return self._in_the_last(run, rival, ideal=ideal) or self._before(run)

    def _before(self, run: Measured) -> str:
        """In the second and the third quarter: a controller that follows in the end alone does not follow."""
        most = max(STILL_SHARE * run.farthest, self.tolerance or 0.0)
        for name, error in (("second", run.second), ("third", run.third)):
            if not error <= most:
                return (
                    f"the error in the {name} quarter is {plain(error, run.unit)}, and a robot that holds still errs "
                    f"by {plain(run.farthest, run.unit)} where it errs most"
                )
        return ""

    def _in_the_last(self, run: Measured, rival: Measured | None, *, ideal: bool) -> str:
        if self.tolerance is not None:
            if not run.last <= self.tolerance:
                return f"the tolerance is {plain(self.tolerance, run.unit)}"
            if run.farthest <= self.tolerance:
                return (
                    f"a robot that holds still errs by {plain(run.farthest, run.unit)} at most, which is within the "
                    f"tolerance of {plain(self.tolerance, run.unit)}: state a smaller one, or a start off the goal"
                )
            return ""
        if not run.follows:
            return f"a robot that holds still errs by {plain(run.still, run.unit)}; at most half of that is required"
        if rival is None:
            return f"no rival is fair ({self.lacking}): state a tolerance in the graph" if ideal else ""
        if not rival.follows:
            return f"the {self.rival} does not follow either: state a tolerance in the graph" if ideal else ""
        margin = max(abs(rival.last - rival.third), RESOLUTION)
        if run.last > rival.last + margin:
            return f"the {self.rival} errs by {plain(rival.last, run.unit)}"
        return ""


def quarters(shares: np.ndarray, error: np.ndarray, still: np.ndarray) -> tuple[float, float, float, float]:
    """Second, third and last quarter of an error, and the last of holding still; 0 where no instant is in one.

    Parameters
    ----------
    shares
        (N,) times by the whole duration.
    error, still
        (N,) Euclidean norms.
    """
    parts = [(shares >= k / 4) & (shares < (k + 1) / 4 if k < 3 else True) for k in (1, 2, 3)]
    found = [_rms(error[part]) for part in parts]
    return found[0], found[1], found[2], _rms(still[parts[2]])


def farthest(shares: np.ndarray, still: np.ndarray) -> float:
    """The largest of what `quarters` would say of holding still in the second, the third and the last."""
    return max(quarters(shares, still, still)[:3])


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
