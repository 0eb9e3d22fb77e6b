"""A simulation: from a diagram to recorded signals."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, final

import casadi as ca
import numpy as np

from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import Signal, Variable, stack
from dmframe.errors import EngineError, ValueFault
from dmframe.simulate.rank import Rank, ranks, watched
from dmframe.simulate.start import start_state
from dmframe.simulate.step import RK4_STABLE, Solver, Step, build_step

CHUNK = 256
"""Ticks computed in one call; between calls progress is told and Ctrl-C is heard."""

MOST_NUMBERS = 500_000_000
"""States times ticks that a run keeps; 4 GB."""

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

    Raises
    ------
    StartError, EngineError, ValueFault
        A start pose that cannot be reached; an integrator that fails at once or a run too long to keep; a time that is
        not above zero.
    """
    solver = solver or Solver()
    for name, value in (("duration", duration), ("clock", clock)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise ValueFault(f"{name}: expected a positive number of seconds, found {value}", path=(name,))
    loop = diagram.loop
    matrices = watched(diagram)
    recorded = [*_recorded(diagram), *matrices]
    _check_length(duration / (solver.output if clock is None else clock), loop.state.numel())
    step = build_step(loop, clock, solver, stack(signal.expression for signal in recorded))
    state, p = start_state(diagram, start or {}), loop.p_values
    notices = _stiffness(diagram, step, solver, state, p)
    ticks = max(1, round(duration / step.period))
    begin = time.perf_counter()
    history, end = _march(step, state, p, ticks, progress)
    count = _finite(history)
    times = np.arange(count) * step.period
    outputs = _outputs(step, history[:, :count], times, p, recorded)
    ranked = ranks(matrices, {signal.label: outputs.pop(signal.label) for signal in matrices}, times)
    wall = time.perf_counter() - begin
    variables = (*loop.controller, *loop.plant)
    divergence = None
    if count < history.shape[1]:
        row = int(np.flatnonzero(~np.isfinite(history[:, count]))[0])
        divergence = _divergence(variables, row, count * step.period)
    elif end is End.FAILED:
        row = _fastest(step, history[:, -1], times[-1], p)
        divergence = _divergence(variables, row, float(times[-1]), "moves too fast for the integrator")
    return Run(
        diagram=diagram,
        clock=clock,
        duration=ticks * step.period,
        solver=solver,
        time=times,
        states=_split(variables, history[:, :count]),
        outputs=outputs,
        divergence=divergence,
        interrupted=end is End.STOPPED,
        wall_time=wall,
        engine="interpreted",
        notices=(*notices, *(rank.notice for rank in ranked if rank.notice)),
        ranks=ranked,
    )


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
    STOPPED = "stopped by Ctrl-C"
    FAILED = "the integrator failed"


def _check_length(ticks: float, states: int) -> None:
    if ticks * max(states, 1) > MOST_NUMBERS:
        raise EngineError(
            f"duration: a run of {ticks:.3g} ticks with {states} states is too long to keep, "
            f"expected at most {MOST_NUMBERS // max(states, 1)} ticks; run a shorter time or take a slower clock",
            path=("duration",),
        )


def _march(
    step: Step, state: np.ndarray, p: np.ndarray, ticks: int, progress: Progress | None
) -> tuple[np.ndarray, End]:
    """States at every tick, (size, ticks + 1), cut short where they stop being finite or at Ctrl-C."""
    history = np.empty((state.size, ticks + 1), order="F")
    history[:, 0] = state
    done, chunks = 0, dict[int, Any]()
    try:
        while done < ticks:
            size = min(CHUNK, ticks - done)
            if size not in chunks:
                chunks[size] = step.tick.mapaccum(f"ticks_{size}", size)
            many = chunks[size](history[:, done], np.arange(done, done + size)[None, :], p)
            history[:, done + 1 : done + size + 1] = many.full()
            done += size
            if progress is not None:
                progress(done * step.period)
            if not np.all(np.isfinite(history[:, done])):
                break
    except KeyboardInterrupt:
        return history[:, : done + 1], End.STOPPED
    except RuntimeError as error:  # CasADi's, for an adaptive integrator that gives up
        done = _march_singly(step, history, done, p)
        if done == 0:
            raise EngineError(f"solver: the integrator failed in the first tick: {_last_line(error)}") from None
        return history[:, : done + 1], End.FAILED
    return history[:, : done + 1], End.DONE


def _march_singly(step: Step, history: np.ndarray, done: int, p: np.ndarray) -> int:
    """Go again through the ticks of a chunk that failed, up to the one that cannot be computed."""
    while done + 1 < history.shape[1]:
        try:
            history[:, done + 1] = step.tick(history[:, done], done, p).full().ravel()
        except RuntimeError:
            break
        done += 1
    return done


def _last_line(error: RuntimeError) -> str:
    return str(error).strip().splitlines()[-1]


def _fastest(step: Step, state: np.ndarray, t: float, p: np.ndarray) -> int:
    """The state of the plant, as a row of all, that moves fastest in proportion to its size."""
    rate = step.rate(state, t, p).full().ravel()
    first = int(state.size - rate.size)
    speed = np.abs(rate) / (1e-6 + np.abs(state[first:]))
    return first + int(np.argmax(np.nan_to_num(speed, nan=np.inf)))


def _finite(history: np.ndarray) -> int:
    """How many leading columns are finite."""
    bad = np.flatnonzero(~np.all(np.isfinite(history), axis=0))
    return int(bad[0]) if bad.size else history.shape[1]


def _divergence(variables: tuple[Variable, ...], row: int, time: float, how: str = Divergence.how) -> Divergence:
    for variable in variables:
        if row < variable.symbol.numel():
            return Divergence(variable.block, variable.name, row, time, how)
        row -= variable.symbol.numel()
    raise EngineError("a state outside the diagram diverged")


def _split(items: tuple[Variable, ...] | list[Signal], rows: np.ndarray) -> dict[str, np.ndarray]:
    parts, first = dict[str, np.ndarray](), 0
    for item in items:
        size = (item.symbol if isinstance(item, Variable) else item.expression).numel()
        parts[item.label] = rows[first : first + size].T
        first += size
    return parts


def _outputs(
    step: Step, history: np.ndarray, times: np.ndarray, p: np.ndarray, recorded: list[Signal]
) -> dict[str, np.ndarray]:
    """Outputs at every tick, from the recorded states and the same equations."""
    rows = np.empty((step.outputs.size1_out(0), times.size), order="F")
    mapped = dict[int, Any]()
    for first in range(0, times.size, CHUNK):
        part = slice(first, min(first + CHUNK, times.size))
        size = part.stop - part.start
        if size not in mapped:
            mapped[size] = step.outputs.map(size)
        rows[:, part] = mapped[size](history[:, part], times[None, part], np.tile(p[:, None], size)).full()
    return _split(recorded, rows)


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
