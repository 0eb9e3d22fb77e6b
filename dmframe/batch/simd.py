"""Compiled loop that advances several runs at once, each in one element of a vector register (SIMD)."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, final

import numpy as np

from dmframe.batch.figures import LAST, PER_OUTPUT
from dmframe.build import load
from dmframe.build.library import address
from dmframe.build.trial import called
from dmframe.codegen import simd_source
from dmframe.common.errors import EngineError
from dmframe.results.metrics import EIGHTHS
from dmframe.simulate.engine import Trial, alike
from dmframe.simulate.step import Step


@final
@dataclass(frozen=True)
class SimdLoop:
    """Compiled loop for `width` simultaneous runs.

    Parameters
    ----------
    step
        Tick to compute; its recorded outputs are the measured signals. Each run has its own number of integrator steps.
    """

    step: Step
    run: Any
    width: int

    @property
    def name(self) -> str:
        """Name of the engine, see `Measured.engine`."""
        return f"SIMD batch of {self.width}"

    def start(self, states: np.ndarray, p: np.ndarray, substeps: np.ndarray) -> Group:
        """Group of as many runs as there are columns, at most `width`; copies of the last one fill the register.

        Parameters
        ----------
        substeps
            Integrator steps per tick, of each run.
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
        """Advance a group by one tick fewer than `given` has rows; returns the number of runs that have not diverged.

        Parameters
        ----------
        given
            A row per tick from `first` on, as of `Instants`, and the row after them.
        parts
            The eighth of the duration that each row is in, or -1 if the row is not recorded.
        limits
            Limit of each output's absolute value.
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
    """Runs computed in parallel; the last axis of each array is the register element.

    Parameters
    ----------
    count
        Number of runs; further elements repeat the last one.
    substeps
        (width,), integrator steps per tick; the largest determines the computing time.
    figures
        (outputs, `PER_OUTPUT`, width), with sums of squares instead of RMS values.
    ended
        (width,), tick after which a run left its bounds; -1 if it did not.
    """

    count: int
    begin: np.ndarray
    state: np.ndarray
    p: np.ndarray
    substeps: np.ndarray
    figures: np.ndarray
    ended: np.ndarray


def compiled(step: Step) -> tuple[SimdLoop | None, str | None]:
    """Compiled loop of a tick, or None; and a warning."""
    try:
        loaded = load(simd_source(step.parts, implicit=step.implicit), lambda library: _works(library, step))
    except EngineError as error:
        return None, error.text
    if loaded.library is None:
        return None, loaded.notice
    run, width = loaded.library.dm_run_simd, np.zeros(1)
    run.restype = ctypes.c_int64
    loaded.library.dm_width(address(width))
    return SimdLoop(step, run, int(width[0])), loaded.notice


def _works(library: Path, step: Step) -> bool:
    """True if each register element reproduces the interpreter's results over one tick."""
    answer = called(library, "dm_width", [{"doubles": [0.0]}])
    if answer is None:
        return False
    width = int(answer[0][0])
    trial = Trial.of(step, 1 + 0.01 * np.arange(width), after=1)  # all near one state: none diverges by itself
    brief, given = trial.step, trial.given
    group = SimdLoop(brief, None, width).start(trial.states, trial.p, np.ones(width))
    found = called(
        library,
        "dm_run_simd",
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
    after, figures = (np.reshape(array, (-1, width)) for array in (found[1], found[6]))
    last = figures[LAST::PER_OUTPUT]
    return all(alike([after[:, k], last[:, k]], partial(trial.tick, run=k), group.state[:, k]) for k in range(width))
