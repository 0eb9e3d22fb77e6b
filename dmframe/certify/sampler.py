"""Evaluation of a function of time at many instants."""

from __future__ import annotations

from typing import Final, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.diagram import ClosedLoop

HORIZON: Final = 100.0
"""Duration over which a function that cannot be followed exactly is sampled [s]."""

SAMPLES: Final = 20001
"""Number of sampling instants."""


BLOCK: Final = 128
"""Instants evaluated per call: a map of 20 001 takes a second to build."""


@final
class Sampler:
    """Elements of a dense column at any time; each call overwrites the result of the previous one.

    A call through a CasADi buffer takes 1 us instead of 30. The buffer points into these arrays, which must exist as
    long as it does.

    Parameters
    ----------
    function
        Function of the time and of a column of parameters.
    count
        Number of instants evaluated per call.
    """

    def __init__(self, function: ca.Function, p: np.ndarray, count: int = 1) -> None:
        self._function, self._given = function, np.array(p, dtype=float).ravel()
        self._buffer, self._evaluate = (function.map(count) if count > 1 else function).buffer()
        self._time, self._p = np.zeros(count), np.tile(self._given, count)
        self._values = np.zeros(count * function.nnz_out(0))
        for place, given in enumerate((self._time, self._p)):
            self._buffer.set_arg(place, given.data)
        self._buffer.set_res(0, self._values.data)

    def __call__(self, t: float | np.ndarray) -> np.ndarray:
        """Elements at one time; for `count` instants, one after the other."""
        self._time[:] = t
        self._evaluate()
        return self._values

    def over(self, times: np.ndarray) -> np.ndarray:
        """Elements at all times, a row each."""
        many = Sampler(self._function, self._given, BLOCK)
        found = np.zeros((len(times), self._function.nnz_out(0)))
        for first in range(0, len(times), BLOCK):
            part = np.resize(times[first : first + BLOCK], BLOCK)  # the last block is padded by repetition
            found[first : first + BLOCK] = many(part).reshape(BLOCK, -1)[: len(times) - first]
        return found.T


def over_horizon(loop: ClosedLoop, column: SX) -> tuple[np.ndarray, np.ndarray]:
    """Sampling instants of a function of time and parameters, and its elements there, a row each."""
    times = np.linspace(0.0, HORIZON, SAMPLES)
    function = ca.Function("path", [loop.time, loop.p], [ca.densify(column)])
    return times, Sampler(function, loop.p_values).over(times)
