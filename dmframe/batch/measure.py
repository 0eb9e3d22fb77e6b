"""Many runs of one closed loop, of which figures alone are kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, final

import numpy as np

from dmframe.batch.figures import ERROR, Figures, Measured
from dmframe.diagram import Diagram
from dmframe.errors import DmframeError, UnknownNameError, ValueFault, raise_all
from dmframe.results.metrics import EIGHTHS, rms_by_eighth, tracking_error
from dmframe.simulate import Recording, simulate_many
from dmframe.simulate.engine import Choice
from dmframe.simulate.keep import Log
from dmframe.simulate.step import Solver


@final
@dataclass(frozen=True)
class Wanted:
    """What is measured of each run.

    Parameters
    ----------
    signals
        Labels ``block.signal`` of states and outputs, beside the tracking error.
    limits
        By label, `ERROR` too, the absolute value whose first crossing is looked for, in the signal's unit.
    """

    signals: tuple[str, ...] = ()
    limits: Mapping[str, float] | None = None


def measure(
    diagram: Diagram,
    values: Mapping[str, Any],
    duration: float,
    *,
    wanted: Wanted | None = None,
    clock: float | None = None,
    solver: Solver | None = None,
    start: Mapping[str, Any] | None = None,
    engine: Choice = "auto",
    log: Log | None = None,
    threads: int | None = None,
    seed: int = 0,
    jitter: float = 0.0,
) -> Measured:
    """Run a closed loop once for each row of values, and keep figures of each.

    Parameters
    ----------
    values
        By ``block.parameter`` an array with a row a run: (N,) numbers, each of which fills the parameter, or
        (N, *shape). The rest is the diagram's.
    wanted
        Signals and limits beside the tracking error.

    Other parameters are those of `simulate_many`.

    Returns
    -------
    Measured
        The figures that `rms_by_eighth` and the signals' extremes give of whole runs, to rounding.

    Raises
    ------
    UnknownNameError, ValueFault
        A signal or a parameter that there is not; columns of several lengths. (What one run alone cannot have is among
        `Measured.faults`.)
    """
    wanted = wanted or Wanted()
    columns = columns_of(values)
    labels = _check(diagram, wanted)
    variants = [{label: column[i].tolist() for label, column in columns.items()} for i in range(len_of(columns))]
    found = simulate_many(
        diagram,
        variants,
        duration,
        reduce=partial(_figures, labels=labels, limits=wanted.limits or {}),
        clock=clock,
        solver=solver,
        start=start,
        engine=engine,
        log=log,
        threads=threads,
        seed=seed,
        jitter=jitter,
    )
    return _gathered(found)


def columns_of(values: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Values as arrays with a row a run. Raises `ValueFault` where they are none, or differ in length."""
    columns = dict[str, np.ndarray]()
    for label, column in values.items():
        try:
            columns[label] = np.asarray(column, dtype=float)
        except (TypeError, ValueError):
            raise ValueFault(f"values.{label}: expected an array of numbers with a row a run") from None
        if columns[label].ndim == 0:
            raise ValueFault(f"values.{label}: expected a row a run, found one number")
    lengths = {label: len(column) for label, column in columns.items()}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{label} {length}" for label, length in lengths.items())
        raise ValueFault(f"values: expected as many rows of each, found {told}")
    return columns


def len_of(columns: Mapping[str, np.ndarray]) -> int:
    """How many runs there are; one where nothing varies."""
    return next((len(column) for column in columns.values()), 1)


def _check(diagram: Diagram, wanted: Wanted) -> tuple[str, ...]:
    loop = diagram.loop
    known = {*(signal.label for signal in loop.outputs), *(variable.label for variable in loop.variables)}
    labels = tuple(dict.fromkeys(wanted.signals))
    strangers = [label for label in labels if label not in known]
    raise_all([UnknownNameError("signals", "signal", label, known) for label in strangers])
    measured = {*labels, ERROR}
    raise_all(
        [
            UnknownNameError("limits", "measured signal", key, measured)
            for key in wanted.limits or ()
            if key not in measured
        ]
    )
    return labels


@final
@dataclass(frozen=True)
class _Told:
    """What is kept of one run."""

    figures: Mapping[str, tuple[str, dict[str, np.ndarray]]]
    diverged: float
    notices: tuple[str, ...]
    engine: str


def _figures(run: Recording, labels: Sequence[str], limits: Mapping[str, float]) -> _Told:
    units = {item.label: item.unit for item in (*run.diagram.loop.outputs, *run.diagram.loop.variables)}
    error = tracking_error(run)
    figures = {} if error is None else {ERROR: (error.unit, _of(run, error.norm[:, None], limits.get(ERROR)))}
    figures |= {label: (units[label], _of(run, run[label], limits.get(label))) for label in labels}
    diverged = np.nan if run.divergence is None else run.divergence.time
    return _Told(figures, diverged, run.notices, run.engine)


def _of(run: Recording, values: np.ndarray, limit: float | None) -> dict[str, np.ndarray]:
    rms = [
        [np.nan if part is None else part for part in rms_by_eighth(run.time, np.abs(column), run.duration)]
        for column in values.T
    ]
    beyond = np.abs(values) > (np.inf if limit is None else limit)
    first = np.where(beyond.any(axis=0), run.time[beyond.argmax(axis=0)], np.nan)
    return {
        "rms_by_eighth": np.array(rms).reshape(-1, EIGHTHS),
        "least": values.min(axis=0),
        "most": values.max(axis=0),
        "last": values[-1],
        "crossed": first,
    }


def _gathered(found: Sequence[_Told | DmframeError]) -> Measured:
    faults = {i: told for i, told in enumerate(found) if isinstance(told, DmframeError)}
    ran = {i: told for i, told in enumerate(found) if isinstance(told, _Told)}
    one = next(iter(ran.values()), None)
    signals = dict[str, Figures]()
    for label, (unit, parts) in one.figures.items() if one else ():
        arrays = {name: np.full((len(found), *part.shape), np.nan) for name, part in parts.items()}
        for i, told in ran.items():
            for name, part in told.figures[label][1].items():
                arrays[name][i] = part
        signals[label] = Figures(unit, **arrays)
    diverged = np.array([ran[i].diverged if i in ran else np.nan for i in range(len(found))])
    notices = tuple(dict.fromkeys(notice for told in ran.values() for notice in told.notices))
    return Measured(signals, diverged, faults, notices, one.engine if one else "none")
