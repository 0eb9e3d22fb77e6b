"""Machine code that advances several runs at once, an element of a vector register each."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from dmframe.build import load
from dmframe.build.library import address
from dmframe.build.trial import called
from dmframe.codegen import lanes_source
from dmframe.errors import EngineError
from dmframe.results.metrics import EIGHTHS
from dmframe.simulate.engine import alike
from dmframe.simulate.step import Step

PER_OUTPUT: Final = EIGHTHS + 4
"""Figures of one output: the sum of its squares in each eighth, the least, the largest, the last, the crossing."""


@final
@dataclass(frozen=True)
class Lanes:
    """A compiled loop for `width` runs at once.

    Parameters
    ----------
    step
        The tick that it computes; its recorded outputs are those of which figures are kept. Its own number of
        integrator steps counts for nothing: each run has its own.
    """

    step: Step
    run: Any
    width: int

    @property
    def name(self) -> str:
        """As `Measured.engine` tells it."""
        return f"lanes of {self.width}"

    def start(self, states: np.ndarray, p: np.ndarray, substeps: np.ndarray) -> Group:
        """As many runs as there are columns, at most `width`, from their states; others fill what is left.

        Parameters
        ----------
        substeps
            Integrator steps in a tick, of each run.
        """
        count = states.shape[1]
        fill = np.minimum(np.arange(self.width), count - 1)
        outputs = self.step.parts.outputs.numel_out(0)
        figures = np.empty((outputs, PER_OUTPUT, self.width))
        figures[:] = np.array([*[0.0] * EIGHTHS, np.inf, -np.inf, np.nan, -1.0])[:, None]
        ended = np.full(self.width, -1, dtype=np.int64)
        begin, p = (np.ascontiguousarray(values[:, fill]) for values in (states, p))
        return Group(count, begin, begin.copy(), p, np.asarray(substeps, dtype=np.int64)[fill], figures, ended)

    def advance(self, group: Group, given: np.ndarray, first: int, parts: np.ndarray, limits: np.ndarray) -> int:
        """Move a group on by as many ticks as `given` has rows but one; returns how many of its lanes are alive.

        Parameters
        ----------
        given
            A row a tick from `first` on, as of `Instants`, and the row behind them.
        parts
            The eighth that each row is in, or -1 where nothing of it is kept.
        limits
            Of each output's absolute value.
        """
        whole = ctypes.c_int64
        return int(
            self.run(
                address(group.begin),
                address(group.state),
                address(group.p),
                ctypes.c_double(self.step.period),
                address(group.substeps),
                whole(first),
                whole(len(given) - 1),
                address(given),
                address(parts),
                address(limits),
                address(self.step.bounds),
                address(group.figures),
                address(group.ended),
            )
        )


@final
@dataclass(frozen=True)
class Group:
    """Some runs side by side, the last axis of each array being the lanes.

    Parameters
    ----------
    count
        Lanes that count; those behind them repeat the last one.
    substeps
        (lanes,), integrator steps in a tick: the group takes the time of the lane that has most.
    figures
        (outputs, 8 + 4, lanes): sums of squares by eighths, least, most, last, crossed.
    ended
        (lanes,), the tick after which a run left its bounds; -1 for one that did not.
    """

    count: int
    begin: np.ndarray
    state: np.ndarray
    p: np.ndarray
    substeps: np.ndarray
    figures: np.ndarray
    ended: np.ndarray


def compiled(step: Step) -> tuple[Lanes | None, str | None]:
    """The lanes of a tick, or None; and what a user should know of it."""
    try:
        loaded = load(lanes_source(step.parts, implicit=step.implicit), lambda library: _works(library, step))
    except EngineError as error:
        return None, error.text
    if loaded.library is None:
        return None, loaded.notice
    run, width = loaded.library.dm_run_lanes, np.zeros(1)
    run.restype = ctypes.c_int64
    loaded.library.dm_lanes(address(width))
    return Lanes(step, run, int(width[0])), loaded.notice


def _told(step: Step, given: np.ndarray, p: np.ndarray, state: np.ndarray) -> Sequence[Any]:
    moved, recorded, *_ = step.tick(state, given, p)
    return moved, recorded


def _works(library: Path, step: Step) -> bool:
    """True where each lane of a new library gives the interpreter's numbers, over one tick."""
    told = called(library, "dm_lanes", [{"doubles": [0.0]}])
    if told is None:
        return False
    parts, rng, width = step.parts, np.random.default_rng(0), int(told[0][0])
    lanes = 1 + 0.01 * np.arange(width)  # all near one random state, so that all are as tame
    brief = step.with_period(float(step.period) * 1e-3)  # so short that nothing blows up
    given, group = (
        brief.instants.rows(0, 2),
        Lanes(brief, None, width).start(
            rng.uniform(0.5, 1.5, (parts.sample.numel_in(0), 1)) * lanes,
            rng.uniform(0.5, 1.5, (parts.sample.numel_in(4), 1)) * lanes,
            np.ones(width),
        ),
    )
    found = called(
        library,
        "dm_run_lanes",
        [
            *({"doubles": array.ravel().tolist()} for array in (group.begin, group.state, group.p)),
            {"double": brief.period},
            {"integers": group.substeps.tolist()},
            *({"integer": value} for value in (0, 1)),
            {"doubles": given.ravel().tolist()},
            {"integers": [0, -1]},
            {"doubles": [np.inf] * len(group.figures)},
            {"doubles": [1e300] * len(group.state)},
            {"doubles": group.figures.ravel().tolist()},
            {"integers": group.ended.tolist()},
        ],
    )
    if found is None:
        return False
    after, last = (np.reshape(array, (-1, width)) for array in (found[1], found[6]))
    last = last[EIGHTHS + 2 :: PER_OUTPUT]
    for lane in range(width):
        other = partial(_told, brief, given[0], group.p[:, lane])
        if not alike([after[:, lane], last[:, lane]], other, group.state[:, lane]):
            return False
    return True
