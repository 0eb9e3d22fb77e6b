"""A log of commands and positions, as the estimator reads it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

Array = np.ndarray


@final
@dataclass(frozen=True, eq=False)
class Log:
    """Recorded samples.

    Parameters
    ----------
    time
        (N,), instants [s].
    q
        (N, n), positions [rad].
    u
        (N - 1, n), velocity commands, each constant until the next [rad/s].
    ahead
        (n,), q_c - q at the first sample [rad].
    """

    time: Array
    q: Array
    u: Array
    ahead: Array

    @property
    def period(self) -> float:
        """Sampling period, the median interval [s]."""
        return float(np.median(np.diff(self.time)))

    @cached_property
    def noise(self) -> float:
        """Standard deviation of the positions' white noise, from their sixth differences [rad].

        Sixth differences of a motion without frequencies above a tenth of the Nyquist frequency are below 1e-3 of it.
        """
        each = np.diff(self.q, 6, axis=0) / np.sqrt(924.0)
        return float(np.max(1.4826 * np.median(np.abs(each), axis=0)))

    @property
    def moving(self) -> bool:
        """True if the robot may move at the first sample."""
        return bool(np.any(np.abs(self.u[:3]) > 1e-6))
