"""How far a desired motion leads, with which bounds on the error are compared."""

from __future__ import annotations

from typing import Final

import casadi as ca
import numpy as np

from dmframe.diagram import ClosedLoop
from dmframe.diagram.closed_loop import Followed

SAMPLES: Final = 500
"""Instants at which a motion is sampled."""


def extent(loop: ClosedLoop, pair: Followed, over: float) -> float | None:
    """Largest distance of a desired value from its start, over the samples of ``[0, over]``.

    A robot that stands still at the start has no larger error at these instants. None if the value depends on the
    state.
    """
    wanted = loop.on_path(loop.acting([ca.vec(pair.wanted)])[0])
    if ca.depends_on(wanted, loop.state):
        return None
    function = ca.Function("wanted", [loop.time, loop.p], [wanted], {"allow_free": True})
    if function.has_free():
        return None
    times = np.linspace(0.0, over, SAMPLES)
    values = function.map(SAMPLES)(times[None, :], np.tile(loop.p_values[:, None], SAMPLES)).full().T
    return float(np.max(np.linalg.norm(values - values[0], axis=1)))
