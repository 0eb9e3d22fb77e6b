"""What is kept of each of many runs: figures of its error and of some signals."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final, final

import numpy as np

from dmframe.errors import DmframeError, ValueFault
from dmframe.results.metrics import EIGHTHS
from dmframe.units import plain

ERROR: Final = "error"
"""The name of the tracking error's Euclidean norm among the figures."""
TURN: Final = "turn"
"""The name of the angle between a tool's orientation and the desired one among the figures [deg]."""


@final
@dataclass(frozen=True)
class Wanted:
    """What is measured of each run.

    Parameters
    ----------
    signals
        Labels ``block.signal`` of states and outputs, beside the tracking error.
    limits
        By label, `ERROR` and `TURN` too, the absolute value whose first crossing is looked for, in the signal's unit.
    """

    signals: tuple[str, ...] = ()
    limits: Mapping[str, float] = field(default_factory=dict)

    def limit(self, label: str) -> float:
        """Infinite where there is none."""
        return self.limits.get(label, np.inf)


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

    @classmethod
    def empty(cls, unit: str, runs: int, rows: int) -> Figures:
        """Figures of runs of which nothing is known yet, to be written into."""
        rms, *others = (np.full((runs, rows, *more), np.nan) for more in ((EIGHTHS,), (), (), (), ()))
        return cls(unit, rms, *others)

    def put(self, runs: np.ndarray | int, other: Figures) -> None:
        """Write figures of some of the runs."""
        self.rms_by_eighth[runs] = other.rms_by_eighth
        self.least[runs] = other.least
        self.most[runs] = other.most
        self.last[runs] = other.last
        self.crossed[runs] = other.crossed

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
        What ran them: ``lanes of 8``, ``compiled``, ``interpreted``, or several of these.
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


@final
@dataclass(frozen=True)
class Board:
    """Where figures of many runs are written as they come.

    Parameters
    ----------
    steps
        By method, steps that were chosen for stiff plants [s], with the number of runs that took them.
    again
        How many runs were done again at shorter steps.
    """

    signals: Mapping[str, Figures]
    diverged: np.ndarray
    faults: dict[int, DmframeError] = field(default_factory=dict)
    notices: dict[str, None] = field(default_factory=dict)
    engines: dict[str, None] = field(default_factory=dict)
    steps: defaultdict[str, list[tuple[float, int]]] = field(default_factory=lambda: defaultdict(list))
    again: list[int] = field(default_factory=lambda: [0])

    @classmethod
    def empty(cls, signals: Mapping[str, tuple[str, int]], runs: int) -> Board:
        """For signals with their units and rows."""
        figures = {label: Figures.empty(unit, runs, rows) for label, (unit, rows) in signals.items()}
        return cls(figures, np.full(runs, np.nan))

    @classmethod
    def like(cls, found: Measured, runs: int) -> Board:
        """For the signals that others have measured."""
        rows = {label: (figures.unit, figures.last.shape[1]) for label, figures in found.signals.items()}
        return cls.empty(rows, runs)

    def put(self, runs: np.ndarray, found: Measured) -> None:
        """Write what has been measured of some runs. Raises `ValueFault` where it is of other signals."""
        mine, theirs = (
            {label: (figures.unit, figures.last.shape[1]) for label, figures in signals.items()}
            for signals in (self.signals, found.signals)
        )
        if mine != theirs:
            text = "expected runs that measure the same signals, found some of other units or sizes"
            raise ValueFault(f"values: {text}; measure them apart")
        for label, figures in found.signals.items():
            self.signals[label].put(runs, figures)
        self.diverged[runs] = found.diverged
        self.faults.update({int(runs[run]): fault for run, fault in found.faults.items()})
        self.tell(found.engine, *found.notices)

    def tell(self, engine: str, *notices: str) -> None:
        """What ran some of the runs, and what is to be known of them."""
        self.engines[engine] = None
        self.notices.update(dict.fromkeys(notices))

    def measured(self) -> Measured:
        """All of it."""
        engine = " and ".join(self.engines) or "none"
        return Measured(self.signals, self.diverged, self.faults, (*self.notices, *self._chosen()), engine)

    def _chosen(self) -> Iterator[str]:
        """What integrated the runs that needed more than the usual steps."""
        runs = len(self.diverged)
        for method, steps in self.steps.items():
            least, most = (plain(end(step for step, _ in steps), "s") for end in (min, max))
            span = least if least == most else f"{least} to {most}"
            many = sum(count for _, count in steps)
            yield f"the plant is stiff in {many} of {runs} runs: {method} takes steps of {span}"
        if self.again[0]:
            yield f"at longer steps the integrator itself diverged in {self.again[0]} of {runs} runs"
