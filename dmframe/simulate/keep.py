"""What a run keeps: which signals, and how often."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from dmframe.diagram import Diagram, Variable
from dmframe.diagram.closed_loop import ClosedLoop, Signal
from dmframe.errors import EngineError, UnknownNameError, ValueFault, raise_all
from dmframe.simulate.told import telling

MOST_NUMBERS = 500_000_000
"""Numbers that a run keeps at most; 4 GB."""

PLENTY = 20_000_000
"""Where nothing says how often to keep, a longer run keeps fewer instants, so that this many numbers do: 160 MB."""


APART: Final = "R_apart"
"""What blocks call the square of the distance between a tool's orientation and the desired one."""


@final
@dataclass(frozen=True)
class Log:
    """What is asked to be kept.

    Parameters
    ----------
    every
        The time between instants that are kept [s], rounded to whole ticks. None: every tick, or, where that were more
        than `PLENTY` numbers, as often as these allow.
    signals
        Labels ``block.signal`` of states and outputs; None for all but states that are not `recorded`. A trajectory and
        what should follow it are kept always, for the error, and so is how far the tool is turned from its orientation.
    """

    every: float | None = None
    signals: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        """Refuse a time that is none."""
        if self.every is not None and not (math.isfinite(self.every) and self.every > 0):
            raise ValueFault(f"log.every: expected a positive time, found {self.every}", path=("log", "every"))


@final
@dataclass(frozen=True)
class Keeping:
    """A run's log in numbers.

    Parameters
    ----------
    every
        Ticks from one kept instant to the next.
    kept
        Positions in the column (states, outputs) of what is kept.
    columns
        For each kept item its part of a row.
    """

    every: int
    kept: np.ndarray
    columns: tuple[tuple[Variable | Signal, slice], ...]
    notices: tuple[str, ...] = ()

    def rows(self, ticks: int) -> int:
        """How many instants of the ticks 0 to `ticks` are kept."""
        return ticks // self.every + 1


def keeping(
    diagram: Diagram, log: Log, recorded: Sequence[Signal], matrices: Sequence[Signal], period: float, ticks: int
) -> Keeping:
    """Resolve a `Log`; `matrices`, whose rank is watched, are always kept, and so is what a run tells of.

    Raises `UnknownNameError` for a signal that there is not, `EngineError` where it would be more than `MOST_NUMBERS`.
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
        wanted |= {label for label in [apart_of(diagram.loop)] if label is not None}
    wanted |= {matrix.label for matrix in matrices} | {signal.label for signal in telling(diagram)}
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


def apart_of(loop: ClosedLoop) -> str | None:
    """The output that says how far a tool's orientation is from the desired one, as |R - R_d|^2; None without one."""
    return next((signal.label for signal in loop.outputs if signal.name == APART and not signal.shape), None)


def _every(log: Log, period: float, ticks: int, width: int) -> tuple[int, tuple[str, ...]]:
    if log.every is not None:
        every = max(1, round(min(log.every / period, ticks + 1)))  # one that is longer than the run keeps its begin
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
        f"a long run: of {every} instants one is kept, {every * period:g} s apart; log.every says otherwise",
    )
