"""A simulation: from a diagram to recorded signals."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from typing import Any, final

import casadi as ca
import numpy as np

from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import Signal, Variable, stack
from dmframe.errors import DmframeError, EngineError, ValueFault, raise_all
from dmframe.simulate.bounds import Divergence, beyond, bounds_of, located
from dmframe.simulate.engine import CHUNK, Choice, Engine, Stuck, choose
from dmframe.simulate.instants import Instants
from dmframe.simulate.keep import Keeping, Log, keeping
from dmframe.simulate.rank import Rank, ranks, watched
from dmframe.simulate.start import Made, check_start, start_state
from dmframe.simulate.step import MOST_SUBSTEPS, Solver, Step, build_step, substeps_of
from dmframe.simulate.stiffness import MOST_SLOPE, RK4_TAKES, speed_of, stiffness
from dmframe.units import plain

BREATH = 0.05
"""Progress is told, and Ctrl-C is heard, about this often [s]."""

MOST_TICKS = 10_000_000_000
"""Some hours of computing for a small loop."""

Progress = Callable[[float], None]
"""Called with the simulated time [s] that is done."""


@final
@dataclass(frozen=True, repr=False)
class Recording:
    """What a simulation recorded, up to its end or to where it diverged or was stopped.

    Parameters
    ----------
    time
        (N,) [s].
    states, outputs
        By label ``block.name``: (N, rows) arrays.
    ranks
        How close each matrix that must keep its rank came to losing it.
    """

    diagram: Diagram
    clock: float | None
    duration: float
    solver: Solver
    time: np.ndarray
    states: Mapping[str, np.ndarray]
    outputs: Mapping[str, np.ndarray]
    divergence: Divergence | None
    interrupted: bool
    wall_time: float
    engine: str
    notices: tuple[str, ...] = field(default=())
    ranks: tuple[Rank, ...] = field(default=())

    @property
    def real_time_factor(self) -> float:
        """Simulated seconds a second."""
        return float(self.time[-1]) / self.wall_time if self.wall_time > 0 else float("inf")

    def __getitem__(self, label: str) -> np.ndarray:
        return self.outputs[label] if label in self.outputs else self.states[label]

    def __repr__(self) -> str:
        return f"<Recording of {len(self.states) + len(self.outputs)} signals, {self.time.size} instants>"


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
    """Run a closed loop.

    Parameters
    ----------
    duration
        Simulated time [s]; it is rounded to whole ticks.
    clock
        Sampling period of the controller [s]; None for continuous time.
    solver
        How the plant is integrated.
    start
        Start values by state name, ``{"q": [...]}``, or ``{"near": [...]}``; see `start_state`.
    engine
        ``compiled``, ``interpreted``, or ``auto``: compiled where the run is long enough to be worth it. They give the
        same numbers to rounding. `Recording.engine` says which one ran.
    log
        What is kept, and how often.
    seed
        Decides what is drawn at random, where anything is.
    jitter
        How much earlier or later than on a perfect clock each sample may begin [s].

    Raises
    ------
    StartError, EngineError, ValueFault
        A start pose that cannot be reached; an integrator that fails at once or a run too long to keep; a time that is
        not above zero.
    """
    prepared = prepare(
        diagram, duration, clock=clock, solver=solver or Solver(), log=log or Log(), seed=seed, jitter=jitter
    )
    state = start_state(diagram, start or {}, prepared.starts)
    prepared = prepared.stepping(diagram, state)
    recording = prepared.run(diagram, prepared.engine(engine), state, progress)
    chosen = prepared.solver.step if (solver or Solver()).step is None else None
    if recording.divergence is None or chosen is None or prepared.solver.method != "rk4":
        return recording
    return _finer(prepared, diagram, state, engine, recording, chosen / 4)


def _finer(
    prepared: Prepared, diagram: Diagram, state: np.ndarray, engine: Choice, recording: Recording, step: float
) -> Recording:
    """A run that diverged, at shorter steps, where those tell that the integrator did and not the loop."""
    step = max(step, prepared.step.period / MOST_SUBSTEPS)
    solver = replace(prepared.solver, step=step)
    finer = replace(prepared, solver=solver, step=prepared.step.solved_by(solver, prepared.clock))
    again = finer.run(diagram, finer.engine(engine), state)
    if again.divergence is not None and again.divergence.time < 1.5 * recording.divergence.time:  # type: ignore[union-attr]
        return recording
    told = f"at longer steps the integrator itself diverged: rk4 took steps of {plain(step, 's')}"
    return replace(again, notices=(*again.notices, told))


@final
@dataclass(frozen=True)
class Prepared:
    """All of a run that does not depend on numbers: one serves many sets of parameters and starts."""

    clock: float | None
    solver: Solver
    step: Step
    ticks: int
    matrices: Sequence[Signal]
    keeping: Keeping
    starts: Made = field(default_factory=dict)
    notices: tuple[str, ...] = ()

    @cached_property
    def jacobian(self) -> Any:
        """Of the plant's rate."""
        return self.step.rate.jacobian()

    def stepping(self, diagram: Diagram, state: np.ndarray) -> Prepared:
        """The same, with the integrator that the plant takes at that start, where nobody has chosen its step."""
        if self.solver.method != "rk4" or self.solver.step is not None:
            return self
        h, speed = self.step.period / self.step.substeps, speed_of(diagram, self.jacobian, state)
        if not speed < MOST_SLOPE or h * speed <= RK4_TAKES:
            return replace(self, solver=replace(self.solver, step=h))
        h = float(f"{RK4_TAKES / speed:.2g}")
        if self.step.period / h > MOST_SUBSTEPS:
            solver = replace(self.solver, method="cvodes")
            told = "the plant is too stiff for rk4, whose steps would be shorter than 1/2000 of a tick: cvodes runs it"
        else:
            solver = replace(self.solver, step=h)
            told = f"the plant is stiff: rk4 takes steps of {plain(h, 's')}"
        step = self.step.solved_by(solver, self.clock)
        return replace(self, solver=solver, step=step, notices=(*self.notices, told))

    def engine(self, choice: Choice, runs: int = 1) -> Engine:
        """What is to run it, `runs` times."""
        kept = self.keeping
        return choose(choice, self.step, self.solver, kept.every, kept.kept, self.ticks * runs)

    def run(
        self,
        diagram: Diagram,
        engine: Engine,
        state: np.ndarray,
        progress: Progress | None = None,
        guard: AbstractContextManager[Any] | None = None,
    ) -> Recording:
        """Run from a state with the numbers of `diagram`; `guard` is entered where CasADi's expressions are used."""
        guard = guard or nullcontext()
        p, state = diagram.loop.p_values, state.copy()
        with guard:
            stiff = stiffness(diagram, self.step, self.jacobian, self.solver, state)
        begin = time.perf_counter()
        rows, end, done = _march(engine, self.step, self.keeping, state, p, self.ticks, progress)
        wall = time.perf_counter() - begin
        with guard:
            divergence = _divergence(diagram, self.step, end, done, state, p)
            return self._told(diagram, engine, rows, divergence, end, wall, stiff)

    def _told(
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
        ranked = ranks(self.matrices, {label: values for label, (_, values) in items.items()}, times)
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
    """Check what is asked, and build the functions of a tick."""
    check_clock(diagram, clock, jitter)
    ticks, matrices, outputs = ticks_of(duration, clock, solver), watched(diagram), _recorded(diagram)
    recorded = stack(signal.expression for signal in (*outputs, *matrices))
    step = build_step(diagram.loop, clock, solver, recorded, bounds_of(diagram), seed=seed, jitter=jitter)
    kept = keeping(diagram, log, outputs, matrices, step.period, ticks)
    whole, told = ticks * step.period, tuple[str, ...]()
    if abs(whole - duration) > 0.01 * duration:
        told = (
            f"{plain(whole, 's')} are simulated, not {plain(duration, 's')}: whole ticks of {plain(step.period, 's')}",
        )
    return Prepared(clock, solver, step, ticks, matrices, kept, notices=told)


def ticks_of(duration: float, clock: float | None, solver: Solver) -> int:
    """How many ticks a run takes. Raises `ValueFault` and `EngineError` for times with which it cannot be computed."""
    for name, value in (("duration", duration), ("clock", clock)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise ValueFault(f"{name}: expected a positive number of seconds, found {value}", path=(name,))
    if clock is not None and clock > duration * (1 + 1e-9):
        raise ValueFault(
            f"clock: expected at most the simulated time, {plain(duration, 's')}, found {plain(clock, 's')}; take a "
            "faster clock, or run longer",
            path=("clock",),
        )
    substeps_of(clock, solver)
    ticks = duration / (clock if clock is not None else solver.output)
    if ticks > MOST_TICKS:
        slower = "a slower clock" if clock is not None else "a longer solver.output"
        raise EngineError(
            f"duration: a run of {ticks:.3g} ticks is too long, expected at most {MOST_TICKS:.3g}; "
            f"run a shorter time or take {slower}",
            path=("duration",),
        )
    return max(1, round(ticks))


def check_clock(diagram: Diagram, clock: float | None, jitter: float) -> None:
    """Refuse continuous time for what moves from sample to sample."""
    if clock is not None:
        return
    why = diagram.loop.clocked or ("samples have a jitter" if jitter else "")
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
    """Refuse what `simulate` would refuse of times, log and start values, as far as no pose need be sought.

    Raises one fault, or all of them as `Faults`.
    """

    def times_and_log() -> None:
        ticks, period = ticks_of(duration, clock, solver), clock if clock is not None else solver.output
        check_clock(diagram, clock, jitter)
        Instants.of(diagram.loop, period, seed, jitter)
        keeping(diagram, log, _recorded(diagram), watched(diagram), period, ticks)

    faults = list[DmframeError]()
    for ask in (times_and_log, lambda: check_start(diagram, start)):
        try:
            ask()
        except DmframeError as error:
            faults += error.faults
    raise_all(faults)


def _recorded(diagram: Diagram) -> list[Signal]:
    """Outputs worth keeping: columns that move, that are not states already, and whose rank is not watched."""
    loop = diagram.loop
    others = {state.label for state in loop.variables} | {matrix.label for matrix in watched(diagram)}
    moving = stack([loop.time, loop.state, *(leaf.symbol for leaf in (*loop.trajectories, *loop.crossings))])
    return [
        signal
        for signal in loop.outputs
        if signal.label not in others and signal.expression.is_column() and ca.depends_on(signal.expression, moving)
    ]


@final
class End(Enum):
    """How the march through the ticks ended."""

    DONE = "done"
    DIVERGED = "left its bounds"
    STOPPED = "stopped by Ctrl-C"
    FAILED = "the integrator failed"


def _march(
    engine: Engine,
    step: Step,
    keeping: Keeping,
    state: np.ndarray,
    p: np.ndarray,
    ticks: int,
    progress: Progress | None,
) -> tuple[np.ndarray, End, int]:
    """What is kept, a row an instant, how it ended, and how many ticks are done; `state` is moved along."""
    every = keeping.every
    rows = np.empty((keeping.rows(ticks), keeping.kept.size))
    done, size, end = 0, CHUNK, End.DONE
    before = (0, state.copy())  # a chunk's number and state together: Ctrl-C may come between any two lines
    try:
        while done < ticks:
            begin, wanted = time.perf_counter(), min(size, ticks - done)
            reached = engine.advance(state, p, done, wanted, rows[-(-done // every) :])
            if reached < wanted:
                return rows[: keeping.rows(done + reached)], End.DIVERGED, done + reached
            before = (done + wanted, state.copy())
            done = before[0]
            if progress is not None:
                progress(done * step.period)
            if engine.elastic:
                size = max(1, round(size * min(8.0, BREATH / max(time.perf_counter() - begin, 1e-9))))
    except KeyboardInterrupt:
        (done, state), end = before, End.STOPPED
    except Stuck as stuck:
        done += stuck.done
        if done == 0:
            raise EngineError(f"solver: the integrator failed in the first tick: {stuck}") from None
        end = End.FAILED
    if done % every == 0:
        engine.advance(state, p, done, 0, rows[done // every :])
    return rows[: keeping.rows(done)], end, done


def _fastest(step: Step, state: np.ndarray, t: float, p: np.ndarray) -> int:
    """The state of the plant, as a row of all, that moves fastest in proportion to its size."""
    rate = step.rate(state, t, p).full().ravel()
    first = int(state.size - rate.size)
    speed = np.abs(rate) / (1e-6 + np.abs(state[first:]))
    return first + int(np.argmax(np.nan_to_num(speed, nan=np.inf)))


def _divergence(
    diagram: Diagram, step: Step, end: End, done: int, state: np.ndarray, p: np.ndarray
) -> Divergence | None:
    if end is End.DIVERGED:
        return beyond(diagram, state, step.bounds, (done + 1) * step.period)
    if end is not End.FAILED:
        return None
    moment = done * step.period
    variable, element = located(diagram, _fastest(step, state, moment, p))
    return Divergence(variable.block, variable.name, element, moment, "moves too fast for the integrator")
