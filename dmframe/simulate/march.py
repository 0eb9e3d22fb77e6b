"""Loop over the ticks of a run: recording, progress, interruption and divergence."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from enum import Enum
from typing import final

import numpy as np

from dmframe.common.errors import EngineError
from dmframe.diagram import Diagram
from dmframe.simulate.bounds import Divergence, beyond, located
from dmframe.simulate.engine import CHUNK, Engine, Stuck
from dmframe.simulate.keep import Keeping
from dmframe.simulate.step import Step

BREATH = 0.05
"""Interval between progress reports and checks for Ctrl-C [s]."""

Progress = Callable[[float], None]
"""Callback with the simulated time so far [s]."""


@final
class End(Enum):
    """End of the loop over ticks."""

    DONE = "done"
    DIVERGED = "left its bounds"
    STOPPED = "stopped by Ctrl-C"
    FAILED = "the integrator failed"


def march(
    engine: Engine,
    step: Step,
    keeping: Keeping,
    state: np.ndarray,
    p: np.ndarray,
    ticks: int,
    progress: Progress | None,
    marks: Mapping[int, np.ndarray] | None = None,
) -> tuple[np.ndarray, End, int]:
    """Run the ticks; returns recorded rows, end and number of ticks done; `state` is updated in place.

    `marks` are ticks, each with an array that receives the state at its beginning.
    """
    every = keeping.every
    rows = np.empty((keeping.rows(ticks), keeping.kept.size))
    done, size, end = 0, CHUNK, End.DONE
    marks = marks or {}
    before = (0, state.copy())  # one tuple, since Ctrl-C may interrupt between any two statements
    try:
        while done < ticks:
            if done in marks:
                marks[done][:] = state
            ends = [mark for mark in marks if mark > done]
            begin, wanted = time.perf_counter(), min([size, ticks - done, *(mark - done for mark in ends)])
            reached = engine.advance(state, p, done, wanted, rows[-(-done // every) :])
            if reached < wanted:
                return rows[: keeping.rows(done + reached)], End.DIVERGED, done + reached
            before = (done + wanted, state.copy())
            done = before[0]
            if progress is not None:
                progress(done * step.period)
            if engine.elastic:
                size = max(1, round(size * min(8.0, BREATH / max(time.perf_counter() - begin, 1e-9))))
    except KeyboardInterrupt:
        (done, state), end = before, End.STOPPED
    except Stuck as stuck:
        done += stuck.done
        if done == 0:
            raise EngineError(f"solver: the integrator failed in the first tick: {stuck}") from None
        end = End.FAILED
    if done % every == 0:
        engine.advance(state, p, done, 0, rows[done // every :])
    return rows[: keeping.rows(done)], end, done


def _fastest(step: Step, state: np.ndarray, t: float, p: np.ndarray) -> int:
    """Row of the plant state with the largest relative rate."""
    rate = step.rate(state, t, p).full().ravel()
    first = int(state.size - rate.size)
    speed = np.abs(rate) / (1e-6 + np.abs(state[first:]))
    return first + int(np.argmax(np.nan_to_num(speed, nan=np.inf)))


def divergence_of(
    diagram: Diagram, step: Step, end: End, done: int, state: np.ndarray, p: np.ndarray
) -> Divergence | None:
    """Divergence or integrator failure of a run, if any."""
    if end is End.DIVERGED:
        return beyond(diagram, state, step.bounds, (done + 1) * step.period)
    if end is not End.FAILED:
        return None
    moment = done * step.period
    variable, element = located(diagram, _fastest(step, state, moment, p))
    return Divergence(variable.block, variable.name, element, moment, "moves too fast for the integrator")
