"""Simulation of a diagram, with recorded signals."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, final

import casadi as ca
import numpy as np

from dmframe.block.model import SYMBOLIC
from dmframe.common.errors import DmframeError, ValueFault, raise_all
from dmframe.common.units import plain
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import Signal, Variable, stack
from dmframe.simulate.accuracy import Pilot
from dmframe.simulate.block_starts import Made
from dmframe.simulate.bounds import Divergence, bounds_of
from dmframe.simulate.engine import Choice, Compiled, Engine, choose
from dmframe.simulate.growth import growth
from dmframe.simulate.instants import Instants
from dmframe.simulate.keep import Keeping, Log, keeping
from dmframe.simulate.march import End, Progress, divergence_of, march
from dmframe.simulate.rank import ranks, watched
from dmframe.simulate.recording import Recording
from dmframe.simulate.solver import FIXED, MOST_SUBSTEPS, Method, Solver, ticks_of
from dmframe.simulate.start import check_start, start_state
from dmframe.simulate.step import Step, build_step
from dmframe.simulate.stiffness import EXPLICIT_TAKES, MOST_SLOPE, RK4_STEPS, omitted_terms, speed_of, stiffness
from dmframe.simulate.warnings import (
    channel_models,
    exceptions,
    off_path,
    out_of_range,
    too_fast,
    unread,
    warning_signals,
)

LATER = 1.5
"""Factor in the time of divergence at shorter steps above which the integrator caused the divergence."""


def simulate(
    diagram: Diagram,
    duration: float,
    *,
    clock: float | None = None,
    solver: Solver | None = None,
    start: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
    engine: Choice = "auto",
    log: Log | None = None,
    seed: int = 0,
    jitter: float = 0.0,
) -> Recording:
    """Simulate a closed loop.

    Parameters
    ----------
    duration
        Simulated time [s]; it is rounded to whole ticks.
    clock
        Sampling period of the controller [s]; None for continuous time.
    solver
        Integrator of the plant.
    start
        Initial values by state name, ``{"q": [...]}``, or ``{"near": [...]}``; see `start_state`.
    engine
        ``compiled``, ``interpreted``, or ``auto``: compiled if the run is long enough. Results agree up to rounding;
        `Recording.engine` names the engine used.
    log
        Recorded signals and instants.
    seed
        Seed of random signals.
    jitter
        Largest deviation of a sample from the ideal clock [s].

    Raises
    ------
    StartError, EngineError, ValueFault
        If the start pose is unreachable; the integrator fails at once or the run is too long; a time is not positive.
    """
    prepared = prepare(
        diagram, duration, clock=clock, solver=solver or Solver(), log=log or Log(), seed=seed, jitter=jitter
    )
    state = start_state(diagram, start or {}, prepared.starts, prepared.step.instants)
    return prepared.complete(diagram, state, engine, progress=progress)


@final
@dataclass(frozen=True)
class Prepared:
    """Parameter-independent part of a run, shared by many sets of parameters and initial states."""

    clock: float | None
    solver: Solver
    step: Step
    ticks: int
    matrices: Sequence[Signal]
    keeping: Keeping
    starts: Made = field(default_factory=dict)
    engines: dict[Method, Engine] = field(default_factory=dict)
    notices: tuple[str, ...] = ()

    @cached_property
    def slope(self) -> Any:
        """Derivative of the plant's rate in a direction; as an expression, a chain's whole Jacobian takes seconds."""
        return self.step.rate.forward(1)

    def complete(
        self,
        diagram: Diagram,
        state: np.ndarray,
        choice: Choice,
        *,
        shared: Engine | None = None,
        progress: Progress | None = None,
    ) -> Recording:
        """Run from a state with the parameters of `diagram` and automatic steps, unless the user chose a step.

        A diverging run is repeated with shorter steps, and a run that misses the solver's accuracy too; see `Pilot`.
        `shared` is the engine of a batch.
        """
        with SYMBOLIC:
            speed = speed_of(diagram, self.slope, state) if self.solver.method in FIXED else 0.0
            own = self.stepping(state, diagram.loop.p_values, speed)
            engine = own.engine(choice) if shared is None else own.sharing(shared, choice)

        def run(setup: Prepared, marks: dict[int, np.ndarray]) -> Recording:
            with SYMBOLIC:
                used = engine if setup is own else setup.sharing(engine, choice)
            return self._finished(diagram, setup, used, state, speed, choice, progress, marks)

        pilot = Pilot.of(own, self.notices, diagram, state, speed, choice, engine, run)
        return run(own, {}) if pilot is None else pilot.recording(written=self.solver.step is not None)

    def _finished(
        self,
        diagram: Diagram,
        own: Prepared,
        engine: Engine,
        state: np.ndarray,
        speed: float,
        choice: Choice,
        progress: Progress | None,
        marks: dict[int, np.ndarray],
    ) -> Recording:
        """The recording of a setup, repeated with shorter steps if it diverges."""
        recording = own._run(diagram, engine, state, speed, progress, marks)
        finer = self.finer(own)
        if recording.divergence is None or finer is None:
            return recording
        with SYMBOLIC:
            engine = finer.engine(choice)
        finer_recording = finer._run(diagram, engine, state, speed)
        if (
            finer_recording.divergence is not None
            and finer_recording.divergence.time < LATER * recording.divergence.time
        ):
            return recording
        return finer_recording

    def finer(self, own: Prepared) -> Prepared | None:
        """Setup with shorter steps for a run that diverged at the automatic steps of `own`; None for a user's step."""
        if self.solver.step is not None or own.solver.method not in FIXED:
            return None
        step = max(own.step.length / 4, own.step.period / MOST_SUBSTEPS)
        notice = f"the integrator diverged at longer steps: {own.solver.method} takes steps of {plain(step, 's')}"
        finer = own.solved_by(replace(own.solver, step=step))
        return replace(finer, notices=(*finer.notices, notice))

    def stepping(self, state: np.ndarray, p: np.ndarray, speed: float) -> Prepared:
        """Setup with the integrator for a plant of that speed [1/s], unless the user chose a step."""
        if self.solver.method not in FIXED or self.solver.step is not None:
            return self
        h = self.step.length
        if self.solver.method != "rk4" or not speed < MOST_SLOPE or h * speed <= self.solver.takes:
            return replace(self, solver=replace(self.solver, step=h))
        short = float(f"{self.solver.takes / speed:.2g}")
        possible, stiff = self.step.period / short <= MOST_SUBSTEPS, "the plant is stiff: rk4"
        if not (possible and h / short <= RK4_STEPS):
            own = self.solved_by(replace(self.solver, method="ros34pw2"))
            h = own.step.length
            if omitted_terms(own.step, state, p) <= EXPLICIT_TAKES:
                notice = (
                    f"{stiff} would take steps of {plain(short, 's')}; ros34pw2 is used, with steps of {plain(h, 's')}"
                )
                return replace(own, solver=replace(own.solver, step=h), notices=(*self.notices, notice))
        if possible:
            own, notice = (
                self.solved_by(replace(self.solver, step=short)),
                f"{stiff} takes steps of {plain(short, 's')}",
            )
        else:
            own = self.solved_by(replace(self.solver, method="cvodes"))
            notice = (
                "the plant is too stiff for rk4, whose steps would be shorter than 1/2000 of a tick: cvodes is used"
            )
        return replace(own, notices=(*self.notices, notice))

    def solved_by(self, solver: Solver) -> Prepared:
        """Setup with another solver."""
        return replace(self, solver=solver, step=self.step.solved_by(solver, self.clock))

    def engine(self, choice: Choice, runs: int = 1) -> Engine:
        """Engine for `runs` runs."""
        kept = self.keeping
        return choose(choice, self.step, self.solver, kept.every, kept.kept, self.ticks * runs)

    def sharing(self, engine: Engine, choice: Choice) -> Engine:
        """Engine of a batch for one of its runs; compiled code supports all step lengths."""
        method = self.solver.method
        if method in FIXED and method != engine.step.solver.method:
            if method not in self.engines:
                self.engines[method] = self.engine("compiled" if isinstance(engine, Compiled) else choice)
            engine = self.engines[method]
        if isinstance(engine, Compiled) and method in FIXED:
            return replace(engine, step=self.step)
        alike = (engine.step.substeps, engine.step.solver.method) == (self.step.substeps, self.solver.method)
        return engine if alike else self.engine(choice)

    def _run(
        self,
        diagram: Diagram,
        engine: Engine,
        state: np.ndarray,
        speed: float,
        progress: Progress | None = None,
        marks: Mapping[int, np.ndarray] | None = None,
    ) -> Recording:
        p, start, state = diagram.loop.p_values, state, state.copy()
        with SYMBOLIC:
            stiff = stiffness(self.step, self.solver, speed, state, p)
        begin = time.perf_counter()
        rows, end, done = march(engine, self.step, self.keeping, state, p, self.ticks, progress, marks)
        wall = time.perf_counter() - begin
        with SYMBOLIC:
            divergence = divergence_of(diagram, self.step, end, done, state, p)
            found = self._recording(diagram, engine, rows, divergence, end, wall, stiff)
            if end is End.DONE:
                found = replace(found, divergence=growth(diagram, {**found.states, **found.outputs}, found.time))
            return replace(found, start=start, instants=self.step.instants)

    def _recording(
        self,
        diagram: Diagram,
        engine: Engine,
        rows: np.ndarray,
        divergence: Divergence | None,
        end: End,
        wall: float,
        stiff: tuple[str, ...],
    ) -> Recording:
        times = self.step.instants.times(np.arange(len(rows)) * self.keeping.every)
        items = {item.label: (item, rows[:, part]) for item, part in self.keeping.columns}
        columns = {label: values for label, (_, values) in items.items()}
        ranked = ranks(self.matrices, columns, times)
        violations = [
            *exceptions(diagram, warning_signals(diagram), columns, times),
            *too_fast(diagram, columns, times),
            *out_of_range(diagram, columns, times),
            *off_path(diagram, columns),
        ]
        channels = channel_models(diagram)
        for matrix in self.matrices:
            del items[matrix.label]
        return Recording(
            diagram=diagram,
            clock=self.clock,
            duration=self.ticks * self.step.period,
            solver=self.solver,
            time=times,
            states={label: values for label, (item, values) in items.items() if isinstance(item, Variable)},
            outputs={label: values for label, (item, values) in items.items() if isinstance(item, Signal)},
            divergence=divergence,
            interrupted=end is End.STOPPED,
            wall_time=wall,
            engine=engine.name,
            notices=(
                *([channels] if channels else []),
                *unread(diagram),
                *violations,
                *self.notices,
                *self.keeping.notices,
                *engine.notices,
                *stiff,
                *(rank.notice for rank in ranked if rank.notice),
            ),
            ranks=ranked,
        )


def prepare(
    diagram: Diagram,
    duration: float,
    *,
    clock: float | None,
    solver: Solver,
    log: Log,
    seed: int = 0,
    jitter: float = 0.0,
) -> Prepared:
    """Check the arguments and build the functions of a tick."""
    check_clock(diagram, clock, jitter)
    ticks, matrices, outputs = ticks_of(duration, clock, solver), watched(diagram), moving_outputs(diagram)
    recorded = stack(signal.expression for signal in (*outputs, *matrices))
    step = build_step(diagram.loop, clock, solver, recorded, bounds_of(diagram), seed=seed, jitter=jitter)
    kept = keeping(diagram, log, outputs, matrices, step.period, ticks)
    whole, notice = ticks * step.period, tuple[str, ...]()
    if abs(whole - duration) > 0.01 * duration:
        notice = (
            f"{plain(whole, 's')} are simulated, not {plain(duration, 's')}: whole ticks of {plain(step.period, 's')}",
        )
    return Prepared(clock, solver, step, ticks, matrices, kept, notices=notice, starts=diagram.loop.derived)


def check_clock(diagram: Diagram, clock: float | None, jitter: float) -> None:
    """Reject continuous time for discrete-time blocks."""
    if clock is not None:
        return
    why = diagram.loop.discrete_time or ("samples have a jitter" if jitter else "")
    if why:
        text = f"clock: expected a sampling period such as 8 ms, found continuous; {why}"
        raise ValueFault(text, path=("clock",))


def check_run(
    diagram: Diagram,
    duration: float,
    *,
    clock: float | None,
    solver: Solver,
    log: Log,
    start: Mapping[str, Any],
    seed: int = 0,
    jitter: float = 0.0,
) -> None:
    """Check times, log and initial values as `simulate` does, without solving for a pose.

    Raises one fault, or all of them as `Faults`.
    """

    def times_and_log() -> None:
        ticks, period = ticks_of(duration, clock, solver), clock if clock is not None else solver.output
        check_clock(diagram, clock, jitter)
        Instants.of(diagram.loop, period, seed, jitter)
        keeping(diagram, log, moving_outputs(diagram), watched(diagram), period, ticks)

    faults = list[DmframeError]()
    for check in (times_and_log, lambda: check_start(diagram, start)):
        try:
            check()
        except DmframeError as error:
            faults += error.faults
    raise_all(faults)


def moving_outputs(diagram: Diagram) -> list[Signal]:
    """Outputs to record: columns that vary or cause warnings, without states and rank-monitored matrices."""
    loop = diagram.loop
    others = {state.label for state in loop.variables} | {matrix.label for matrix in watched(diagram)}
    leaves = (leaf.symbol for leaf in (*loop.trajectories, *loop.ahead, *loop.sampled_signals))
    moving = stack([loop.time, loop.drawn, loop.state, *leaves])
    warned = {signal.label for signal in warning_signals(diagram)}
    return [
        signal
        for signal in loop.outputs
        if signal.label not in others
        and signal.expression.is_column()
        and (signal.label in warned or ca.depends_on(signal.expression, moving))
    ]
