"""Many runs of one closed loop, of which figures alone are kept."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.batch.figures import ERROR, TURN, Board, Measured, Wanted
from dmframe.batch.lanes import Lanes, compiled
from dmframe.batch.speeds import slope_of, speeds_of
from dmframe.batch.starts import starts_of
from dmframe.batch.together import Together
from dmframe.batch.values import columns_of, parameters_of, runs_in, varied
from dmframe.batch.whole import run_whole
from dmframe.block.model import SYMBOLIC
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.parts import Parts
from dmframe.errors import UnknownNameError, ValueFault, raise_all
from dmframe.results.metrics import TurnError, goal_of, turn_of
from dmframe.simulate.engine import Choice, worth
from dmframe.simulate.keep import Log, apart_of
from dmframe.simulate.many import cores
from dmframe.simulate.run import Prepared, prepare
from dmframe.simulate.step import FIXED, Solver, Step, build_parts

TOGETHER: Final = 4096
"""Runs whose numbers are held at a time."""


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
        To rounding, what the whole runs would give one by one.

    Raises
    ------
    UnknownNameError, NeedsDiagramError, ValueFault
        A signal or a parameter that there is not, or that shapes the diagram; columns of several lengths. (What one run
        alone cannot have is among `Measured.faults`.)
    """
    batch = Batch.of(
        diagram,
        duration,
        wanted=wanted,
        clock=clock,
        solver=solver,
        start=start,
        engine=engine,
        log=log,
        threads=threads,
        seed=seed,
        jitter=jitter,
    )
    return batch.measure(values)


@final
@dataclass(frozen=True)
class Batch:
    """All of many runs that does not depend on their numbers: one serves any number of calls. See `measure`."""

    diagram: Diagram
    duration: float
    wanted: Wanted
    settings: Mapping[str, Any]
    choice: Choice
    threads: int | None
    _compiled: dict[str, tuple[Lanes | None, str | None]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        diagram: Diagram,
        duration: float,
        *,
        wanted: Wanted | None = None,
        engine: Choice = "auto",
        threads: int | None = None,
        **settings: Any,
    ) -> Batch:
        """Check what is asked. Raises `UnknownNameError` for a signal that there is not."""
        if threads is not None and threads < 1:
            raise ValueFault(f"threads: expected at least 1, found {threads}")
        wanted = wanted or Wanted()
        loop = diagram.loop
        known = {*(signal.label for signal in loop.outputs), *(variable.label for variable in loop.variables)}
        raise_all(
            [UnknownNameError("signals", "signal", label, known) for label in wanted.signals if label not in known]
        )
        measured = {*wanted.signals, ERROR, *([] if apart_of(diagram.loop) is None else [TURN])}
        strangers = [label for label in wanted.limits if label not in measured]
        raise_all([UnknownNameError("limits", "measured signal", label, measured) for label in strangers])
        given = {key: value for key, value in settings.items() if value is not None}
        return cls(diagram, duration, wanted, given, engine, threads)

    def measure(self, values: Mapping[str, Any], runs: int = 1) -> Measured:
        """The figures of a run for each row of values; see `dmframe.batch.measure`.

        Parameters
        ----------
        runs
            How many, where nothing varies.
        """
        columns = columns_of(values)
        runs = runs_in(columns, runs)
        rows = {label: (unit, expression.numel()) for label, (unit, expression) in self.channels.items()}
        board = Board.empty(rows, runs)
        asked = self._asked(runs)
        for first in range(0, runs, TOGETHER):
            some = np.arange(first, min(first + TOGETHER, runs))
            left = self._together(columns, board, some) if asked else some
            if left.size:
                self._whole(columns, board, left)
        board.notices.update(dict.fromkeys(notice for _, notice in self._compiled.values() if notice))
        return board.measured()

    @cached_property
    def prepared(self) -> Prepared:
        """As a single run has it."""
        asked = {"clock": None, "solver": Solver(), "log": Log(), **self.settings}
        asked.pop("start", None)
        return prepare(self.diagram, self.duration, **asked)

    @cached_property
    def channels(self) -> dict[str, tuple[str, Any]]:
        """Of each measured signal its unit, and its elements as expressions."""
        loop = self.diagram.loop
        items = {signal.label: (signal.unit, ca.vec(signal.expression)) for signal in loop.outputs}
        items |= {variable.label: (variable.unit, ca.vec(variable.symbol)) for variable in loop.variables}
        goal, found = goal_of(loop), dict[str, tuple[str, Any]]()
        if goal is not None:
            unit, actual = items[goal.actual]
            found[ERROR] = (unit, ca.norm_2(actual - items[goal.desired][1]))
        if (turn := turn_of(loop)) is not None:
            found[TURN] = (TurnError.unit, turn)
        return found | {label: items[label] for label in self.wanted.signals}

    @cached_property
    def _parts(self) -> Parts:
        """Of a tick, its outputs being what is measured."""
        recorded = stack([expression for _, expression in self.channels.values()])
        return build_parts(self.diagram.loop, self.prepared.clock, recorded)

    def lanes(self, step: Step) -> Lanes | None:
        """Machine code for a step's method, which is compiled once; None where that cannot be."""
        method = step.solver.method
        if method not in self._compiled:
            self._compiled[method] = compiled(replace(step, parts=self._parts))
        return self._compiled[method][0]

    @cached_property
    def _slope(self) -> Any:
        return slope_of(self.prepared.step.rate)

    def _asked(self, runs: int) -> bool:
        """True where so many runs should go in lanes."""
        prepared = self.prepared
        wanted = self.choice == "compiled" or (self.choice == "auto" and worth(prepared.step, prepared.ticks * runs))
        return wanted and prepared.solver.method in FIXED and self.lanes(prepared.step) is not None

    def _whole(self, columns: Mapping[str, np.ndarray], board: Board, runs: np.ndarray) -> None:
        settings = {**self.settings, "engine": self.choice, "threads": self.threads}
        run_whole(self.diagram, columns, self.duration, board, runs, self.wanted, **settings)

    def _together(self, columns: Mapping[str, np.ndarray], board: Board, runs: np.ndarray) -> np.ndarray:
        """Run some rows of the columns in lanes; returns those that do not fit."""
        prepared, some = self.prepared, {label: column[runs] for label, column in columns.items()}
        given = self.settings.get("start", {})
        with SYMBOLIC:
            p, faults = parameters_of(self.diagram, some, runs.size)
            board.faults.update({int(runs[run]): fault for run, fault in faults.items()})
            runs, p, some = _without(runs, p, some, faults)  # what has no parameters has no start
            of_run = partial(varied, self.diagram, some)
            states, faults = starts_of(self.diagram, some, of_run, p, given, prepared.step.instants, prepared.starts)
            board.faults.update({int(runs[run]): fault for run, fault in faults.items()})
            good = np.setdiff1d(np.arange(runs.size), list(faults))
            p, states = p[:, good], states[:, good]
            speeds = speeds_of(self._slope, states, p)
        together = Together(self.lanes, prepared, self._limits, self.threads or cores())
        left = together.run(p, states, speeds, board, runs[good])
        return np.asarray(runs[good[left]])

    @property
    def _limits(self) -> np.ndarray:
        """Of each element that is measured."""
        limits = [np.full(elements.numel(), self.wanted.limit(label)) for label, (_, elements) in self.channels.items()]
        return np.concatenate([np.zeros(0), *limits])


def _without(
    runs: np.ndarray, p: np.ndarray, columns: Mapping[str, np.ndarray], faults: Collection[int]
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Runs, their parameters and their rows but for those with a fault."""
    good = np.setdiff1d(np.arange(runs.size), list(faults))
    return runs[good], p[:, good], {label: column[good] for label, column in columns.items()}


__all__ = ["Batch", "Wanted", "measure"]
