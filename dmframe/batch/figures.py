"""What is kept of each of many runs: figures of its error and of some signals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np

from dmframe.errors import DmframeError

ERROR = "error"
"""The name of the tracking error's Euclidean norm among the figures."""


@final
@dataclass(frozen=True, repr=False)
class Figures:
    """Of one signal in N runs, over the instants that a run keeps; nan where a run never came.

    Parameters
    ----------
    unit
        Of all but `crossed`.
    rms_by_eighth
        (N, rows, 8), over each eighth of the planned duration.
    least, most, last
        (N, rows).
    crossed
        (N, rows), when the absolute value first left its limit [s]; nan where it never did, or has none.
    """

    unit: str
    rms_by_eighth: np.ndarray
    least: np.ndarray
    most: np.ndarray
    last: np.ndarray
    crossed: np.ndarray

    @property
    def rms_final(self) -> np.ndarray:
        """(N, rows), over the last eighth."""
        return np.asarray(self.rms_by_eighth[..., -1])


@final
@dataclass(frozen=True, repr=False)
class Measured:
    """The figures of N runs, in their order.

    Parameters
    ----------
    signals
        By label; under `ERROR` the norm of the tracking error, one row, where the loop has a goal.
    diverged
        (N,), when a state left its bounds [s]; nan for a run that came to its end.
    faults
        Of runs that could not be made, by their place; all their figures are nan.
    notices
        What a user should know of the runs together.
    engine
        What ran them: ``lanes of 8``, ``compiled``, ``interpreted``.
    """

    signals: Mapping[str, Figures]
    diverged: np.ndarray
    faults: Mapping[int, DmframeError]
    notices: tuple[str, ...]
    engine: str

    @property
    def runs(self) -> int:
        """N."""
        return len(self.diverged)

    @property
    def error(self) -> Figures | None:
        """Of the tracking error's norm; None without a goal."""
        return self.signals.get(ERROR)

    def __repr__(self) -> str:
        ended = int(np.isfinite(self.diverged).sum())
        return f"<Measured: {self.runs} runs, {ended} diverged, {len(self.faults)} not run; {', '.join(self.signals)}>"
