"""Error bounds of a rehearsal.

In the last quarter of a run, the error must be within the graph's tolerance, which a stationary robot must not meet.
Without a tolerance, it must be at most half the error of a stationary robot, and not larger than the error of the
kinematic inverse of J under the same condition. In the second and third quarter, it must be at most half the largest
error of a stationary robot, or within the tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from dmframe.common.units import plain

FOLLOWING_FRACTION: Final = 0.5
"""Largest error of a controller as a fraction of a stationary robot's error; a rule of thumb."""
RESOLUTION: Final = 1e-5
"""Measurement resolution of arms, below which differences of errors are ignored [m, rad]."""


@final
@dataclass(frozen=True)
class Measured:
    """RMS errors of one run.

    Parameters
    ----------
    signal, unit
        Name and unit of the error.
    second, third, last
        Error in these quarters of the run.
    still
        Error of a stationary robot in the last quarter.
    stopped
        Reason of an early end; empty if the run was completed.
    moved
        Largest error of a stationary robot in a quarter, without the first.
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
        """True if the run was completed with at most half the error of a stationary robot."""
        return not self.stopped and self.last <= FOLLOWING_FRACTION * self.still

    @property
    def farthest(self) -> float:
        """Largest error of a stationary robot."""
        return max(self.still, self.moved)


@final
@dataclass(frozen=True)
class ErrorBounds:
    """Reference values of the errors.

    Parameters
    ----------
    tolerance
        Tolerance of the graph, in the unit of its error; None without one.
    rival
        Name of the reference controller; empty if none is applicable.
    lacking
        Why none is applicable.
    """

    tolerance: float | None = None
    rival: str = ""
    lacking: str = ""

    def above(self, run: Measured, rival: Measured | None, *, ideal: bool) -> str:
        """Reason for which an error is too large; empty if it is not.

        The margin to the rival is the change of its error from the third quarter to the last, at least `RESOLUTION`.
        """
        return self._in_the_last(run, rival, ideal=ideal) or self._before(run)

    def _before(self, run: Measured) -> str:
        """Check the second and third quarter."""
        most = max(FOLLOWING_FRACTION * run.farthest, self.tolerance or 0.0)
        for name, error in (("second", run.second), ("third", run.third)):
            if not error <= most:
                return (
                    f"the error in the {name} quarter is {plain(error, run.unit)}; the largest error of a stationary "
                    f"robot is {plain(run.farthest, run.unit)}"
                )
        return ""

    def _in_the_last(self, run: Measured, rival: Measured | None, *, ideal: bool) -> str:
        if self.tolerance is not None:
            if not run.last <= self.tolerance:
                return f"the tolerance is {plain(self.tolerance, run.unit)}"
            if run.farthest <= self.tolerance:
                return (
                    f"the error of a stationary robot, at most {plain(run.farthest, run.unit)}, is within the "
                    f"tolerance of {plain(self.tolerance, run.unit)}: set a smaller one, or a start off the goal"
                )
            return ""
        if not run.follows:
            return f"the error of a stationary robot is {plain(run.still, run.unit)}; at most half of it is allowed"
        if rival is None:
            return f"no rival is applicable ({self.lacking}): set a tolerance in the graph" if ideal else ""
        if not rival.follows:
            return f"the {self.rival} does not follow either: set a tolerance in the graph" if ideal else ""
        margin = max(abs(rival.last - rival.third), RESOLUTION)
        if run.last > rival.last + margin:
            return f"the error of the {self.rival} is {plain(rival.last, run.unit)}"
        return ""


def quarters(times: np.ndarray, error: np.ndarray, still: np.ndarray) -> tuple[float, float, float, float]:
    """RMS error in the second, third and last quarter, and a stationary robot's in the last; 0 without an instant.

    Parameters
    ----------
    times
        (N,) times relative to the duration.
    error, still
        (N,) norms of the error, and of a stationary robot's error.
    """
    parts = [(times >= k / 4) & (times < (k + 1) / 4 if k < 3 else True) for k in (1, 2, 3)]
    found = [_rms(error[part]) for part in parts]
    return found[0], found[1], found[2], _rms(still[parts[2]])


def farthest(times: np.ndarray, still: np.ndarray) -> float:
    """Largest RMS error of a stationary robot in the second, third and last quarter."""
    return max(quarters(times, still, still)[:3])


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
