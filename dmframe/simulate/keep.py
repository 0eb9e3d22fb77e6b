"""Recording of a run: selected signals and instants."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from dmframe.common.errors import EngineError, UnknownNameError, ValueFault, raise_all
from dmframe.diagram import Diagram, Variable
from dmframe.diagram.closed_loop import ClosedLoop, Signal
from dmframe.simulate.warnings import warning_signals

MOST_NUMBERS = 500_000_000
"""Maximum number of recorded values; 4 GB."""

PLENTY = 20_000_000
"""Default limit of recorded values, 160 MB: longer runs record fewer instants."""


ROTATION_DISTANCE: Final = "R_apart"
"""Port name of the squared distance between actual and desired tool orientation."""


@final
@dataclass(frozen=True)
class Log:
    """Requested recording.

    Parameters
    ----------
    every
        Time between recorded instants [s], rounded to whole ticks. None: every tick, or as often as `PLENTY` values
        allow.
    signals
        Labels ``block.signal`` of states and outputs; None for all except states that are not `recorded`. Desired and
        actual goal signals and the orientation error are always recorded.
    """

    every: float | None = None
    signals: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        """Check the time."""
        if self.every is not None and not (math.isfinite(self.every) and self.every > 0):
            raise ValueFault(f"log.every: expected a positive time, found {self.every}", path=("log", "every"))


@final
@dataclass(frozen=True)
class Keeping:
    """Resolved `Log`.

    Parameters
    ----------
    every
        Ticks between recorded instants.
    kept
        Recorded positions in the column (states, outputs).
    columns
        Slice of a row for each recorded item.
    """

    every: int
    kept: np.ndarray
    columns: tuple[tuple[Variable | Signal, slice], ...]
    notices: tuple[str, ...] = ()

    def rows(self, ticks: int) -> int:
        """Number of recorded instants of the ticks 0 to `ticks`."""
        return ticks // self.every + 1


def keeping(
    diagram: Diagram, log: Log, recorded: Sequence[Signal], matrices: Sequence[Signal], period: float, ticks: int
) -> Keeping:
    """Resolve a `Log`; rank-monitored `matrices` and signals with warnings are always recorded.

    Raises `UnknownNameError` for an unknown signal, `EngineError` for more than `MOST_NUMBERS` values.
    """
    variables = diagram.loop.variables
    items: list[Variable | Signal] = [*variables, *recorded, *matrices]
    known = {variable.label for variable in variables} | {signal.label for signal in recorded}
    wanted = known - {variable.label for variable in variables if not variable.recorded}
    if log.signals is not None:
        strangers = [name for name in dict.fromkeys(log.signals) if name not in known]
        path = ("log", "signals")
        raise_all([UnknownNameError("log.signals", "signal", name, known, path=path) for name in strangers])
        wanted = {*log.signals, *(label for pair in diagram.loop.goals for label in pair[:2])}
        wanted |= {label for label in [rotation_distance_of(diagram.loop)] if label is not None}
    wanted |= {matrix.label for matrix in matrices} | {signal.label for signal in warning_signals(diagram)}
    kept, columns, first, width = list[np.ndarray](), list[tuple[Variable | Signal, slice]](), 0, 0
    for item in items:
        size = (item.symbol if isinstance(item, Variable) else item.expression).numel()
        if item.label in wanted:
            kept.append(np.arange(first, first + size, dtype=np.int64))
            columns.append((item, slice(width, width + size)))
            width += size
        first += size
    every, notices = _every(log, period, ticks, max(width, 1))
    return Keeping(every, np.concatenate([np.zeros(0, np.int64), *kept]), tuple(columns), notices)


def rotation_distance_of(loop: ClosedLoop) -> str | None:
    """Label of the output |R - R_d|^2 (squared orientation error of a tool); None without one."""
    return next(
        (signal.label for signal in loop.outputs if signal.name == ROTATION_DISTANCE and not signal.shape), None
    )


def _every(log: Log, period: float, ticks: int, width: int) -> tuple[int, tuple[str, ...]]:
    if log.every is not None:
        every = max(1, round(min(log.every / period, ticks + 1)))  # if longer than the run, only the start is recorded
        if ticks // every * width > MOST_NUMBERS:
            most = MOST_NUMBERS // width
            raise EngineError(
                f"log.every: a run of {ticks:.3g} ticks with {width} numbers at each instant is too long to keep, "
                f"expected at most {most} instants; take {ticks * period / most:.3g} s or more, or fewer log.signals",
                path=("log", "every"),
            )
        few = ticks // every < 2
        return every, ("log.every keeps fewer than three instants of this run",) if few and ticks > 1 else ()
    every = max(1, math.ceil(ticks * width / PLENTY))
    if every == 1:
        return 1, ()
    return every, (
        f"a long run: one of {every} instants is recorded, every {every * period:g} s; set log.every to change it",
    )
