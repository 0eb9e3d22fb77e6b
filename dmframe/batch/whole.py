"""Figures of many runs, each made whole by an engine of its own: slower than in lanes, and for every loop."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple, final

import numpy as np

from dmframe.batch.figures import ERROR, TURN, Board, Figures, Wanted
from dmframe.diagram import Diagram
from dmframe.errors import DmframeError, NeedsDiagramError, UnknownNameError
from dmframe.results.metrics import rms_by_eighth, tracking_error, turn_error
from dmframe.simulate import Recording, simulate_many


def run_whole(
    diagram: Diagram,
    columns: Mapping[str, np.ndarray],
    duration: float,
    board: Board,
    runs: np.ndarray,
    wanted: Wanted,
    **settings: Any,
) -> None:
    """Run some rows of the columns, and write their figures to the board.

    Raises
    ------
    UnknownNameError, NeedsDiagramError
        A label that cannot be varied, whatever its value.
    """
    variants = [{label: column[run].tolist() for label, column in columns.items()} for run in runs]
    found = simulate_many(diagram, variants, duration, reduce=partial(of_run, wanted=wanted), **settings)
    for run, told in zip(runs.tolist(), found, strict=True):
        if isinstance(told, UnknownNameError | NeedsDiagramError):
            raise told
        if isinstance(told, DmframeError):
            board.faults[run] = told
            continue
        board.tell(told.engine, *told.notices)
        board.diverged[run] = told.diverged
        for label, figures in told.figures.items():
            board.signals[label].put(run, figures)


@final
class Told(NamedTuple):
    """What is kept of a run."""

    figures: Mapping[str, Figures]
    diverged: float
    notices: tuple[str, ...]
    engine: str


def of_run(run: Recording, wanted: Wanted) -> Told:
    """The figures of one whole run."""
    error, turn = tracking_error(run), turn_error(run)
    values = {} if error is None else {ERROR: error.norm[:, None]}
    values |= {} if turn is None else {TURN: turn.angle[:, None]}
    values |= {label: run[label] for label in wanted.signals}
    diverged = np.nan if run.divergence is None else run.divergence.time
    figures = {label: _figures(run, signal, wanted.limit(label)) for label, signal in values.items()}
    return Told(figures, diverged, run.notices, run.engine)


def _figures(run: Recording, values: np.ndarray, limit: float) -> Figures:
    rms = [rms_by_eighth(run.time, np.abs(column), run.duration) for column in values.T]
    beyond = np.abs(values) > limit
    return Figures(
        unit="",
        rms_by_eighth=np.array(rms, dtype=float),  # None is nan
        least=values.min(axis=0),
        most=values.max(axis=0),
        last=values[-1],
        crossed=np.where(beyond.any(axis=0), run.time[beyond.argmax(axis=0)], np.nan),
    )
