"""A simulation: from a diagram to recorded signals."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, final

import casadi as ca
import numpy as np

from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import Signal, Variable, stack
from dmframe.errors import EngineError, ValueFault
from dmframe.simulate.engine import CHUNK, Choice, Engine, Stuck, choose
from dmframe.simulate.keep import Keeping, Log, keeping
from dmframe.simulate.rank import Rank, ranks, watched
from dmframe.simulate.start import start_state
from dmframe.simulate.step import RK4_STABLE, Solver, Step, build_step

BREATH = 0.05
"""Progress is told, and Ctrl-C is heard, about this often [s]."""

Progress = Callable[[float], None]
"""Called with the simulated time [s] that is done."""


@final
@dataclass(frozen=True)
class Divergence:
    """Where a run left the finite numbers first, or moved too fast for the integrator: `how` says which."""

    block: str
    state: str
    element: int
    time: float
    how: str = "is no longer finite"

    def __str__(self) -> str:
        return f"{self.block}.{self.state}[{self.element}] {self.how} at t = {self.time:.6g} s"


@final
@dataclass(frozen=True)
class Run:
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
) -> Run:
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
        same numbers to rounding. `Run.engine` says which one ran.
    log
        What is kept, and how often.

    Raises
    ------
    StartError, EngineError, ValueFault
        A start pose that cannot be reached; an integrator that fails at once or a run too long to keep; a time that is
        not above zero.
    """
    prepared = prepare(diagram, duration, clock=clock, solver=solver or Solver(), log=log or Log())
    chosen = prepared.engine(engine)
    return prepared.run(diagram, chosen, start or {}, progress)


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

    def engine(self, choice: Choice, runs: int = 1) -> Engine:
        """What is to run it, `runs` times."""
        kept = self.keeping
        return choose(choice, self.step, self.solver, kept.every, kept.kept, self.ticks * runs)

    def run(self, diagram: Diagram, engine: Engine, start: Mapping[str, Any], progress: Progress | None) -> Run:
        """Run with the numbers of `diagram`."""
        step, keeping, loop = self.step, self.keeping, diagram.loop
        state, p = start_state(diagram, start), loop.p_values
        notices = (*keeping.notices, *engine.notices, *_stiffness(diagram, step, self.solver, state, p))
        begin = time.perf_counter()
        rows, end, done = _march(engine, step, keeping, state, p, self.ticks, progress)
        times = np.arange(len(rows)) * (keeping.every * step.period)
        kept = {item.label: rows[:, part] for item, part in keeping.columns}
        ranked = ranks(self.matrices, kept, times)
        wall = time.perf_counter() - begin
        divergence = None
        variables = (*loop.controller, *loop.plant)
        if end is End.DIVERGED:
            row = int(np.flatnonzero(~np.isfinite(state))[0])
            divergence = _divergence(variables, row, (done + 1) * step.period)
        elif end is End.FAILED:
            moment = done * step.period
            row = _fastest(step, state, moment, p)
            divergence = _divergence(variables, row, moment, "moves too fast for the integrator")
        matrices = {matrix.label for matrix in self.matrices}
        return Run(
            diagram=diagram,
            clock=self.clock,
            duration=self.ticks * step.period,
            solver=self.solver,
            time=times,
            states={i.label: kept[i.label] for i, _ in keeping.columns if isinstance(i, Variable)},
            outputs={
                i.label: kept[i.label] for i, _ in keeping.columns if isinstance(i, Signal) and i.label not in matrices
            },
            divergence=divergence,
            interrupted=end is End.STOPPED,
            wall_time=wall,
            engine=engine.name,
            notices=(*notices, *(rank.notice for rank in ranked if rank.notice)),
            ranks=ranked,
        )


def prepare(diagram: Diagram, duration: float, *, clock: float | None, solver: Solver, log: Log) -> Prepared:
    """Check what is asked, and build the functions of a tick."""
    for name, value in (("duration", duration), ("clock", clock)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise ValueFault(f"{name}: expected a positive number of seconds, found {value}", path=(name,))
    matrices, plain = watched(diagram), _recorded(diagram)
    recorded = [*plain, *matrices]
    step = build_step(diagram.loop, clock, solver, stack(signal.expression for signal in recorded))
    ticks = max(1, round(duration / step.period))
    return Prepared(clock, solver, step, ticks, matrices, keeping(diagram, log, plain, matrices, step.period, ticks))


def _recorded(diagram: Diagram) -> list[Signal]:
    """Outputs worth keeping: columns that move, that are not states already, and whose rank is not watched."""
    loop = diagram.loop
    others = {state.label for state in (*loop.controller, *loop.plant)} | {matrix.label for matrix in watched(diagram)}
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
    DIVERGED = "left the finite numbers"
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


def _divergence(variables: tuple[Variable, ...], row: int, time: float, how: str = Divergence.how) -> Divergence:
    for variable in variables:
        if row < variable.symbol.numel():
            return Divergence(variable.block, variable.name, row, time, how)
        row -= variable.symbol.numel()
    raise EngineError("a state outside the diagram diverged")


def _stiffness(diagram: Diagram, step: Step, solver: Solver, state: np.ndarray, p: np.ndarray) -> tuple[str, ...]:
    """Is the plant too stiff, at the start, for a fixed-step method? At rest the friction law is steepest."""
    if solver.method != "rk4" or not diagram.loop.plant:
        return ()
    size = stack(v.symbol for v in diagram.loop.plant).numel()
    jacobian = step.rate.jacobian()(state, 0, p, 0)[0].full()[:, -size:]
    h = step.period / step.substeps
    fastest = h * float(np.max(np.abs(np.linalg.eigvals(jacobian)))) if np.all(np.isfinite(jacobian)) else np.inf
    if fastest > 0.9 * RK4_STABLE:
        return (
            f"the plant is stiff: at rest h |lambda| = {fastest:.2f} for rk4 at {h * 1e3:.3g} ms, stable up to "
            f"{RK4_STABLE}; take solver.step: {0.8 * h * 1e3 * RK4_STABLE / fastest:.2g} ms, or solver.method: cvodes",
        )
    return ()
