"""The values of a function of time, at one instant after the other."""

from __future__ import annotations

from typing import Final, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.diagram import ClosedLoop

HORIZON: Final = 100.0
"""Time over which a function that cannot be followed exactly is looked at [s]."""

SAMPLES: Final = 20001
"""Instants at which it is looked at."""


@final
class Sampler:
    """The elements of a dense column at any time; each call overwrites what the last one returned.

    A buffer of CasADi takes a microsecond, where a call takes thirty, and building a map of 20 001 takes a second. It
    points into these arrays, which have to live as long as it does.

    Parameters
    ----------
    function
        Of the time and of a column of parameters.
    """

    def __init__(self, function: ca.Function, p: np.ndarray) -> None:
        self._buffer, self._evaluate = function.buffer()
        self._time, self._p = np.zeros(1), np.array(p, dtype=float)
        self._values = np.zeros(function.nnz_out(0))
        for place, given in enumerate((self._time, self._p)):
            self._buffer.set_arg(place, given.data)
        self._buffer.set_res(0, self._values.data)

    def __call__(self, t: float) -> np.ndarray:
        """The elements at one time."""
        self._time[0] = t
        self._evaluate()
        return self._values

    def over(self, times: np.ndarray) -> np.ndarray:
        """The elements at all times, a row each."""
        return np.array([self(t).copy() for t in times.tolist()]).reshape(len(times), -1).T


def over_horizon(loop: ClosedLoop, column: SX) -> tuple[np.ndarray, np.ndarray]:
    """The instants at which a function of time and parameters is looked at, and its elements there, a row each."""
    times = np.linspace(0.0, HORIZON, SAMPLES)
    function = ca.Function("path", [loop.time, loop.p], [column])
    return times, np.asarray(function(times[None, :], loop.p_values).full())
