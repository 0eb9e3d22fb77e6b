"""Figures of merit of many runs: RMS, extremes, last value and first limit crossing of the error and of signals."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, final

import numpy as np

from dmframe.common.errors import DmframeError, ValueFault
from dmframe.common.units import plain
from dmframe.results.metrics import EIGHTHS

ERROR: Final = "error"
"""Label of the Euclidean norm of the tracking error."""
TURN: Final = "turn"
"""Label of the angle between the tool's orientation and the desired one [deg]."""
PER_OUTPUT: Final = EIGHTHS + 4
"""Figures of one scalar: RMS in each eighth, least, most, last, time of the first crossing."""
LEAST, MOST, LAST, CROSSED = range(EIGHTHS, PER_OUTPUT)


@final
@dataclass(frozen=True)
class MeasuredSignals:
    """What to measure in each run, in addition to the tracking error.

    Parameters
    ----------
    signals
        Labels ``block.signal`` of states and outputs.
    limits
        By label (also `ERROR` and `TURN`), the absolute value whose first crossing is recorded, in the signal's unit.
    """

    signals: tuple[str, ...] = ()
    limits: Mapping[str, float] = field(default_factory=dict)

    def limit(self, label: str) -> float:
        """The limit of a label; infinite without one."""
        return self.limits.get(label, np.inf)


@final
@dataclass(frozen=True, repr=False)
class Figures:
    """Figures of one signal in N runs, over the recorded instants; NaN after a divergence.

    Parameters
    ----------
    unit
        Unit of all figures except `crossed`, which is in seconds.
    data
        (N, rows, `PER_OUTPUT`).
    """

    unit: str
    data: np.ndarray

    @property
    def rms_by_eighth(self) -> np.ndarray:
        """(N, rows, 8), over each eighth of the planned duration."""
        return self.data[..., :EIGHTHS]

    @property
    def least(self) -> np.ndarray:
        """(N, rows)."""
        return self.data[..., LEAST]

    @property
    def most(self) -> np.ndarray:
        """(N, rows)."""
        return self.data[..., MOST]

    @property
    def last(self) -> np.ndarray:
        """(N, rows)."""
        return self.data[..., LAST]

    @property
    def crossed(self) -> np.ndarray:
        """(N, rows): time at which the absolute value first exceeded its limit [s]; nan if it never did."""
        return self.data[..., CROSSED]

    @property
    def rms_final(self) -> np.ndarray:
        """(N, rows), over the last eighth."""
        return self.data[..., EIGHTHS - 1]


@final
@dataclass(frozen=True, repr=False)
class Measured:
    """Figures of N runs, in their order.

    Parameters
    ----------
    signals
        By label; `ERROR` is the norm of the tracking error, one row, if the loop has a goal.
    diverged
        (N,), time at which a state left its bounds [s]; nan for a completed run.
    faults
        By run: why it could not be prepared; its figures are nan.
    notices
        Warnings about the runs as a whole.
    engine
        Engines used: ``SIMD batch of 8``, ``compiled``, ``interpreted``, or several of these.
    """

    signals: Mapping[str, Figures]
    diverged: np.ndarray
    faults: Mapping[int, DmframeError]
    notices: tuple[str, ...]
    engine: str

    @property
    def runs(self) -> int:
        """Number of runs."""
        return len(self.diverged)

    @property
    def error(self) -> Figures | None:
        """Figures of the tracking error's norm; None without a goal."""
        return self.signals.get(ERROR)

    @property
    def layout(self) -> dict[str, tuple[str, int]]:
        """Unit and number of rows of each signal."""
        return {label: (figures.unit, figures.data.shape[1]) for label, figures in self.signals.items()}

    def part(self, first: int, stop: int) -> Measured:
        """Results of the runs [first, stop)."""
        signals = {label: Figures(item.unit, item.data[first:stop]) for label, item in self.signals.items()}
        faults = {run - first: fault for run, fault in self.faults.items() if first <= run < stop}
        return Measured(signals, self.diverged[first:stop], faults, self.notices, self.engine)

    def __repr__(self) -> str:
        ended = int(np.isfinite(self.diverged).sum())
        return f"<Measured: {self.runs} runs, {ended} diverged, {len(self.faults)} not run; {', '.join(self.signals)}>"


@final
class FigureTable:
    """Figures of N runs, filled as runs finish.

    Parameters
    ----------
    layout
        Unit and number of rows of each signal, by label.

    Attributes
    ----------
    data
        (N, outputs, `PER_OUTPUT`), the rows of all signals in the order of the layout.
    steps
        By method, the integrator steps chosen for stiff plants [s], with the number of runs.
    repeated
        Number of runs repeated with shorter steps.
    """

    def __init__(self, layout: Mapping[str, tuple[str, int]], runs: int) -> None:
        self.layout, self.diverged = dict(layout), np.full(runs, np.nan)
        self.data = np.full((runs, sum(rows for _, rows in layout.values()), PER_OUTPUT), np.nan)
        self.faults = dict[int, DmframeError]()
        self.notices, self.engines = dict[str, None](), dict[str, None]()
        self.steps = defaultdict[str, list[tuple[float, int]]](list)
        self.repeated = 0

    def put(self, runs: np.ndarray, found: Measured) -> None:
        """Write the figures of some runs of the same signals."""
        self.data[runs] = np.concatenate([self.data[runs, :0], *(item.data for item in found.signals.values())], axis=1)
        self.diverged[runs] = found.diverged
        self.faults.update({int(runs[run]): fault for run, fault in found.faults.items()})
        self.note(found.engine, *found.notices)

    def note(self, engine: str, *notices: str) -> None:
        """Record the engine of some runs, and their warnings."""
        self.engines[engine] = None
        self.notices.update(dict.fromkeys(notices))

    def measured(self) -> Measured:
        """Results of all runs."""
        signals, first = dict[str, Figures](), 0
        for label, (unit, rows) in self.layout.items():
            signals[label] = Figures(unit, self.data[:, first : first + rows])
            first += rows
        engine = " and ".join(self.engines) or "none"
        return Measured(signals, self.diverged, self.faults, (*self.notices, *self._step_notices()), engine)

    def _step_notices(self) -> Iterator[str]:
        """Notices on the integrator steps of stiff runs."""
        runs = len(self.diverged)
        for method, steps in self.steps.items():
            least, most = (plain(end(step for step, _ in steps), "s") for end in (min, max))
            span = least if least == most else f"{least} to {most}"
            many = sum(count for _, count in steps)
            yield f"the plant is stiff in {many} of {runs} runs: {method} takes steps of {span}"
        if self.repeated:
            yield f"the integrator diverged at longer steps in {self.repeated} of {runs} runs"


def merged(parts: Sequence[tuple[np.ndarray, Measured]], runs: int) -> Measured:
    """Merge results of subsets of N runs; raises `ValueFault` if they measure different signals."""
    layout = parts[0][1].layout
    if any(part.layout != layout for _, part in parts):
        text = "expected runs that measure the same signals, found some with other units or sizes"
        raise ValueFault(f"values: {text}; sweep them separately")
    table = FigureTable(layout, runs)
    for some, part in parts:
        table.put(some, part)
    return table.measured()
