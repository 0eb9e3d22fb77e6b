"""What a controller must reach by itself in a rehearsal, however small the change that a condition makes.

A tolerance that the graph states; without one, at most half the error of a robot that holds still, and no larger an
error than the kinematic inverse of J under the same condition.
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
    """

    signal: str
    unit: str
    second: float
    third: float
    last: float
    still: float
    stopped: str

    @property
    def follows(self) -> bool:
        """True where it came to its end with at most half the error of holding still."""
        return not self.stopped and self.last <= STILL_SHARE * self.still


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
        if self.tolerance is not None:
            return "" if run.last <= self.tolerance else f"the tolerance is {plain(self.tolerance, run.unit)}"
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


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
