"""Many runs of one closed loop, several at a time in vector registers, reduced to figures of merit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.batch.figures import ERROR, TURN, Figures, FigureTable, Measured, MeasuredSignals
from dmframe.batch.groups import SimdRunner, slope_of, speeds_of
from dmframe.batch.simd import SimdLoop, compiled
from dmframe.batch.starts import starts_of
from dmframe.batch.values import columns_of, parameters_of, runs_in, varied
from dmframe.block.model import SYMBOLIC
from dmframe.common.cores import cores
from dmframe.common.errors import DmframeError, NeedsDiagramError, UnknownNameError, ValueFault, raise_all
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.parts import Parts
from dmframe.results.metrics import TurnError, counted_rows, goal_of, rms_by_eighth, tracking_error, turn_error, turn_of
from dmframe.simulate import Recording, simulate_many
from dmframe.simulate.block_starts import once
from dmframe.simulate.engine import Choice, worth
from dmframe.simulate.keep import Log, rotation_distance_of
from dmframe.simulate.many import chosen_for_all
from dmframe.simulate.run import Prepared, prepare
from dmframe.simulate.solver import FIXED, Solver
from dmframe.simulate.step import Step, build_parts

BLOCK: Final = 4096
"""Runs whose parameters and states are in memory at a time."""


@final
@dataclass(frozen=True)
class Batch:
    """Runs of one closed loop with different numbers; prepared and compiled once for any number of calls.

    Runs go in SIMD batches where the loop can be compiled and the method has fixed steps, else one by one.
    """

    diagram: Diagram
    duration: float
    wanted: MeasuredSignals
    settings: Mapping[str, Any]
    choice: Choice
    threads: int | None
    _compiled: dict[str, tuple[SimdLoop | None, str | None]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        diagram: Diagram,
        duration: float,
        *,
        wanted: MeasuredSignals | None = None,
        engine: Choice = "auto",
        threads: int | None = None,
        **settings: Any,
    ) -> Batch:
        """Check the arguments; `settings` are those of `simulate_many`.

        Raises
        ------
        UnknownNameError
            A signal that the loop does not have.
        """
        if threads is not None and threads < 1:
            raise ValueFault(f"threads: expected at least 1, found {threads}")
        wanted, loop = wanted or MeasuredSignals(), diagram.loop
        known = {*(signal.label for signal in loop.outputs), *(variable.label for variable in loop.variables)}
        raise_all(
            [UnknownNameError("signals", "signal", label, known) for label in wanted.signals if label not in known]
        )
        measured = {*wanted.signals, ERROR, *([] if rotation_distance_of(loop) is None else [TURN])}
        unknown = [label for label in wanted.limits if label not in measured]
        raise_all([UnknownNameError("limits", "measured signal", label, measured) for label in unknown])
        given = {key: value for key, value in settings.items() if value is not None}
        return cls(diagram, duration, wanted, given, engine, threads)

    def measure(self, values: Mapping[str, Any], runs: int = 1) -> Measured:
        """Run the loop once for each row of values; the figures equal those of single runs, to rounding.

        Parameters
        ----------
        values
            By ``block.parameter`` an array with a row per run: (N,) numbers, each of which fills the parameter, or
            (N, *shape). Other parameters are those of the diagram.
        runs
            Number of runs if nothing varies.

        Raises
        ------
        UnknownNameError, NeedsDiagramError, ValueFault
            A parameter is unknown or determines the diagram's structure; columns differ in length. (Faults of single
            runs are in `Measured.faults`.)
        """
        columns = columns_of(values)
        runs = runs_in(columns, runs)
        table = FigureTable(self.layout, runs)
        simd = self._in_simd(runs)
        for first in range(0, runs, BLOCK):
            left = np.arange(first, min(first + BLOCK, runs))
            if simd:
                left = self._run_simd(columns, table, left)
            if left.size:
                self._run_whole(columns, table, left)
        table.notices.update(dict.fromkeys(notice for _, notice in self._compiled.values() if notice))
        return table.measured()

    @cached_property
    def prepared(self) -> Prepared:
        """Step function, clock and solver, as for a single run."""
        settings = {"clock": None, "solver": Solver(), "log": Log(), **self.settings}
        start = settings.pop("start", {})
        return chosen_for_all(prepare(self.diagram, self.duration, **settings), self.diagram, start, self.choice)

    @cached_property
    def channels(self) -> dict[str, tuple[str, Any]]:
        """Unit and elements, as expressions, of each measured signal."""
        loop = self.diagram.loop
        items = {signal.label: (signal.unit, ca.vec(signal.expression)) for signal in loop.outputs}
        items |= {variable.label: (variable.unit, ca.vec(variable.symbol)) for variable in loop.variables}
        goal, found = goal_of(loop), dict[str, tuple[str, Any]]()
        if goal is not None:
            shape = next(signal.shape for signal in loop.outputs if signal.label == goal.actual)
            rows, unit, _ = counted_rows(self.diagram, shape, items[goal.actual][0])
            found[ERROR] = (unit, ca.norm_2((items[goal.actual][1] - items[goal.desired][1])[rows]))
        if (turn := turn_of(loop)) is not None:
            found[TURN] = (TurnError.unit, turn)
        return found | {label: items[label] for label in self.wanted.signals}

    @property
    def layout(self) -> dict[str, tuple[str, int]]:
        """Unit and number of rows of each measured signal."""
        return {label: (unit, expression.numel()) for label, (unit, expression) in self.channels.items()}

    @cached_property
    def _parts(self) -> Parts:
        """Functions of a tick with the measured signals as outputs."""
        recorded = stack([expression for _, expression in self.channels.values()])
        clock, loop = self.prepared.clock, self.diagram.loop
        key = ("measured", clock is None, *self.channels)
        found: Parts = once(loop.derived, key, lambda: build_parts(loop, clock, recorded))
        return found

    def simd(self, step: Step) -> SimdLoop | None:
        """Machine code for a step's method, compiled once for all clocks; None if it cannot be compiled."""
        method, own = step.solver.method, replace(step, parts=self._parts)
        if method not in self._compiled:
            key = ("simd", method, self.prepared.clock is None, *self.channels)
            code, notice = once(self.diagram.loop.derived, key, lambda: compiled(own))
            self._compiled[method] = code and replace(code, step=own), notice
        return self._compiled[method][0]

    @cached_property
    def _slope(self) -> Any:
        loop, step = self.diagram.loop, self.prepared.step
        timed = ca.depends_on(stack(loop.rates_of(loop.flowing)), loop.period)  # then it depends on the period
        return once(loop.derived, ("slope", step.period if timed else None), lambda: slope_of(step.rate))

    def _in_simd(self, runs: int) -> bool:
        prepared = self.prepared
        wanted = self.choice == "compiled" or (self.choice == "auto" and worth(prepared.step, prepared.ticks * runs))
        return wanted and prepared.solver.method in FIXED and self.simd(prepared.step) is not None

    def _run_simd(self, columns: Mapping[str, np.ndarray], table: FigureTable, runs: np.ndarray) -> np.ndarray:
        """Run some rows of the columns in SIMD batches; returns the runs that are too stiff for them."""
        prepared, some = self.prepared, {label: column[runs] for label, column in columns.items()}
        with SYMBOLIC:
            p, faults = parameters_of(self.diagram, some, runs.size)
            table.faults.update({int(runs[run]): fault for run, fault in faults.items()})
            good = np.setdiff1d(np.arange(runs.size), list(faults))  # a run without parameters has no start
            runs, p, some = runs[good], p[:, good], {label: column[good] for label, column in some.items()}
            states, faults = starts_of(
                self.diagram,
                some,
                partial(varied, self.diagram, some),
                p,
                self.settings.get("start", {}),
                prepared.step.instants,
                prepared.starts,
            )
            table.faults.update({int(runs[run]): fault for run, fault in faults.items()})
            good = np.setdiff1d(np.arange(runs.size), list(faults))
            p, states = p[:, good], states[:, good]
            speeds = speeds_of(self._slope, states, p)
        limits = [np.full(elements.numel(), self.wanted.limit(label)) for label, (_, elements) in self.channels.items()]
        runner = SimdRunner(self.simd, prepared, np.concatenate([np.zeros(0), *limits]), self.threads or cores())
        return np.asarray(runs[good[runner.run(p, states, speeds, table, runs[good])]])

    def _run_whole(self, columns: Mapping[str, np.ndarray], table: FigureTable, runs: np.ndarray) -> None:
        """Run some rows of the columns one by one, with any engine, and reduce each recording."""
        variants = [{label: column[run].tolist() for label, column in columns.items()} for run in runs]
        chosen = {"solver": self.prepared.solver, "engine": self.choice, "threads": self.threads}
        settings = {**self.settings, **chosen}
        reduced = partial(figures_of_run, wanted=self.wanted)
        table.notices.update(dict.fromkeys(self.prepared.notices))
        found = simulate_many(self.diagram, variants, self.duration, reduce=reduced, **settings)
        for run, result in zip(runs.tolist(), found, strict=True):
            if isinstance(result, UnknownNameError | NeedsDiagramError):
                raise result
            if isinstance(result, DmframeError):
                table.faults[run] = result
            else:
                table.put(np.array([run]), result)


def figures_of_run(run: Recording, wanted: MeasuredSignals) -> Measured:
    """Reduce one recording to its figures, without units."""
    error, turn = tracking_error(run), turn_error(run)
    values = {} if error is None else {ERROR: error.norm[:, None]}
    values |= {} if turn is None else {TURN: turn.angle[:, None]}
    values |= {label: run[label] for label in wanted.signals}
    found = dict[str, Figures]()
    for label, signal in values.items():
        rows = list[list[Any]]()
        for column in signal.T:
            beyond = np.abs(column) > wanted.limit(label)
            crossed = run.time[beyond.argmax()] if beyond.any() else np.nan
            rms = rms_by_eighth(run.time, np.abs(column), run.duration)
            rows.append([*rms, column.min(), column.max(), column[-1], crossed])
        found[label] = Figures("", np.array([rows], dtype=float))  # None becomes nan
    diverged = np.nan if run.divergence is None else run.divergence.time
    return Measured(found, np.array([diverged]), {}, run.notices, run.engine)
