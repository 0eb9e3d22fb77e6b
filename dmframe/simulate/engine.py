"""Engines that run a closed loop: compiled C code, or the CasADi interpreter."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Final, Literal, Protocol, final, get_args

import casadi as ca
import numpy as np

from dmframe.build import first_time, load
from dmframe.build.library import address
from dmframe.build.trial import called
from dmframe.common.errors import EngineError, ValueFault
from dmframe.diagram.rosenbrock import ROS34PW2
from dmframe.remembered.recorder import paused
from dmframe.simulate.block_starts import once
from dmframe.simulate.solver import FIXED, Solver
from dmframe.simulate.step import Step

Choice = Literal["auto", "compiled", "interpreted"]

WORTH = 50_000_000
"""Instructions of a run above which `auto` compiles it; a fraction of a second when interpreted."""

CHUNK = 256
"""Ticks per call of the interpreter."""


class Stuck(Exception):
    """Failure of an adaptive integrator after `done` ticks of the chunk."""

    def __init__(self, done: int, reason: str) -> None:
        super().__init__(reason)
        self.done = done


class Engine(Protocol):
    """Protocol of an engine that advances a closed loop."""

    @property
    def step(self) -> Step:
        """Functions of a tick."""

    @property
    def name(self) -> str:
        """Name in `Recording.engine`."""

    @property
    def notices(self) -> tuple[str, ...]:
        """Warnings about the choice of the engine."""

    @property
    def elastic(self) -> bool:
        """True if a call may compute any number of ticks."""

    def advance(self, state: np.ndarray, p: np.ndarray, first: int, ticks: int, rows: np.ndarray) -> int:
        """Advance `state` in place by `ticks` ticks, and write the recorded values to `rows`.

        Returns the number of ticks that ended within bounds; if it is smaller, `state` is that after the next one. With
        zero ticks, the row of `first` is written.
        """


def choose(choice: Choice, step: Step, solver: Solver, every: int, kept: np.ndarray, ticks: int) -> Engine:
    """Select the engine for one or several runs with `ticks` ticks in total."""
    if choice not in get_args(Choice):
        raise ValueFault(f"engine: expected {', '.join(get_args(Choice))}, found {choice!r}", path=("engine",))
    wanted = choice == "compiled" or (choice == "auto" and solver.method in FIXED and worth(step, ticks))
    notices = list[str]()
    if wanted and solver.method not in FIXED:
        notices.append(f"engine: {solver.method} runs interpreted; solver.method {' or '.join(FIXED)} can be compiled")
    elif wanted:
        found, notice = _compiled(step)
        if notice is not None and (first_time(notice) or choice == "compiled"):
            notices.append(notice)
        if found is not None:
            return Compiled(step, kept, every, found, tuple(notices))
    states = step.parts.sample.numel_in(0)
    rows = kept[kept >= states] - states
    if rows.size < step.parts.outputs.numel_out(0):
        step, kept = step.recording(rows), np.concatenate([kept[kept < states], states + np.arange(rows.size)])
    return Interpreted(step, kept, every, tuple(notices))


def worth(step: Step, ticks: int) -> bool:
    """True if compiling saves time for this number of ticks."""
    return ticks * work_of(step) > WORTH


def work_of(step: Step) -> int:
    """Instructions in a tick."""
    parts = step.parts
    substep = 4 * parts.rate.n_instructions()
    if step.implicit:
        (_, more), evaluations = parts.implicit, ROS34PW2.stages - 1
        substep = more.begin.n_instructions() + evaluations * (
            parts.rate.n_instructions() + more.solve.n_instructions()
        )
    return int(parts.sample.n_instructions() + parts.outputs.n_instructions() + step.substeps * substep)


def _compiled(step: Step) -> tuple[Any, str | None]:
    from dmframe.codegen import loop_source  # deferred: not needed by the interpreter

    try:
        with paused():  # what a run concludes does not depend on its engine
            source = partial(loop_source, step.parts, implicit=step.implicit)
            text: str = once(step.parts.derived, ("source", step.implicit), source)
            loaded = load(text, lambda library: _works(library, step))
    except EngineError as error:
        return None, error.text
    if loaded.library is None:
        return None, loaded.notice
    run = loaded.library.dm_run
    run.restype = ctypes.c_int64
    return run, loaded.notice


SCALES: Final = (1.0, 1e-3, 1e-6)
"""Scales of the test states of a new library; the first one with moderate results is used."""
LAST_DIGITS: Final = 1e-11
"""Relative perturbation of states that measures the effect of rounding."""
FRACTIONS: Final = (1e-3, 1e-2)
"""Fractions of the period for the comparison: short, to avoid divergence. A law may divide by the period."""
TAME: Final = 1e6
"""Limit of moderate results: the rounding of larger ones exceeds the absolute tolerance of `alike`."""


@final
@dataclass(frozen=True)
class Trial:
    """Short tick from random states, to compare a new library with the interpreter.

    Parameters
    ----------
    step
        The step with a short period, to avoid divergence.
    given
        Rows of `Instants`, of the tick and of later ones.
    states, p
        One column per run. The states are scaled so that the results are moderate.
    """

    step: Step
    given: np.ndarray
    states: np.ndarray
    p: np.ndarray

    @classmethod
    def of(cls, step: Step, spread: np.ndarray | float = 1.0, after: int = 0) -> Trial:
        """Trial with one run for each factor in `spread` on random states and parameters."""
        sample, rng = step.parts.sample, np.random.default_rng(0)
        states, p = (rng.uniform(0.5, 1.5, (sample.numel_in(place), 1)) * spread for place in (0, 4))
        briefs = [step.with_period(float(step.period) * fraction) for fraction in FRACTIONS]
        trials = [cls(each, each.instants.rows(0, 1 + after), scale * states, p) for each in briefs for scale in SCALES]
        return next((trial for trial in trials if trial._moderate), trials[len(SCALES) - 1])

    def tick(self, state: np.ndarray, run: int) -> Sequence[Any]:
        """State after the tick and outputs recorded before it, by the interpreter."""
        return list(self.step.tick(state, self.given[0], self.p[:, run])[:2])

    @property
    def _moderate(self) -> bool:
        """True if the results are below `TAME`: division by a short period amplifies rounding errors."""
        runs = enumerate(self.states.T)
        return all(np.max(np.abs(item.full()), initial=0.0) < TAME for k, x in runs for item in self.tick(x, k))


def _works(library: Path, step: Step) -> bool:
    """Compare a new library with the interpreter over one tick."""
    count = step.parts.outputs.numel_out(0)
    trial = Trial.of(step)
    brief, given, state, p = trial.step, trial.given, trial.states[:, 0], trial.p[:, 0]
    kept = (state.size + np.arange(count)).tolist()
    found = called(
        library,
        "dm_run",
        [
            {"doubles": state.tolist()},
            {"doubles": p.tolist()},
            {"double": brief.period},
            *({"integer": value} for value in (1, 0, 1)),
            {"doubles": given.ravel().tolist()},
            {"integer": 1},
            {"integers": kept},
            {"integer": count},
            {"doubles": [0.0] * count},
            {"doubles": [1e300] * state.size},
        ],
    )
    if found is None:
        return False
    return alike([found[0][: state.size], found[3][:count]], partial(trial.tick, run=0), state)


def alike(found: Sequence[Any], reference: Callable[[np.ndarray], Sequence[Any]], state: np.ndarray) -> bool:
    """Compare the results of a new library with those of the interpreter, up to rounding.

    The effect of rounding is measured with the interpreter at perturbed states: at a random state, a law may be badly
    conditioned.
    """
    rng = np.random.default_rng(1)
    shaken = [reference(state * (1 + LAST_DIGITS * rng.uniform(-1, 1, state.size))) for _ in range(3)]
    for place, theirs in enumerate(item.full().ravel() for item in reference(state)):
        mine, others = np.asarray(found[place]), [item[place].full().ravel() for item in shaken]
        with np.errstate(invalid="ignore"):
            lost = np.nan_to_num(np.max(np.abs(others - theirs), axis=0, initial=0.0))
            close = np.abs(mine - theirs) <= 1e-9 + 1e-6 * np.abs(theirs) + 100 * lost
        if not np.all(close | (mine == theirs) | (np.isnan(mine) & np.isnan(theirs))):
            return False
    return True


@final
@dataclass(frozen=True)
class Compiled:
    """Compiled engine; releases the GIL, so that several threads can run."""

    step: Step
    kept: np.ndarray
    every: int
    run: Any
    notices: tuple[str, ...] = ()
    name: str = "compiled"
    elastic: bool = True

    def advance(self, state: np.ndarray, p: np.ndarray, first: int, ticks: int, rows: np.ndarray) -> int:
        """See `Engine`."""
        whole = ctypes.c_int64
        given = self.step.instants.rows(first, max(1, ticks))
        return int(
            self.run(
                address(state),
                address(p),
                ctypes.c_double(self.step.period),
                whole(self.step.substeps),
                whole(first),
                whole(ticks),
                address(given),
                whole(self.every),
                address(self.kept),
                whole(self.kept.size),
                address(rows),
                address(self.step.bounds),
            )
        )


@final
class Chunk:
    """Function of several ticks, called without array conversion."""

    def __init__(self, tick: Any, ticks: int) -> None:
        begin, p = (ca.MX.sym(name, tick.numel_in(i)) for i, name in ((0, "begin"), (2, "p")))
        given = ca.MX.sym("given", tick.numel_in(1), ticks)
        many = tick.mapaccum(f"ticks_{ticks}", ticks)
        self._function = ca.Function("chunk", [begin, given, p], many(begin, given, p))
        self._given = [np.empty(self._function.numel_in(i)) for i in range(3)]
        self._states = np.empty((ticks + 1, tick.numel_out(0)))
        self._recorded = np.empty((ticks, tick.numel_out(1)))
        self._buffer, self._evaluate = self._function.buffer()
        for i, array in enumerate(self._given):
            self._buffer.set_arg(i, array.data)
        self._buffer.set_res(0, self._states[1:].data)
        self._buffer.set_res(1, self._recorded.data)

    def __call__(self, state: np.ndarray, given: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """States (one more than ticks) and recorded outputs, one row a tick; overwritten by the next call."""
        for array, value in zip(self._given, (state, given.ravel(), p), strict=True):
            array[:] = value
        self._states[0] = state
        self._evaluate()
        return self._states, self._recorded


@final
@dataclass(frozen=True)
class Interpreted:
    """CasADi interpreter."""

    step: Step
    kept: np.ndarray
    every: int
    notices: tuple[str, ...] = ()
    name: str = "interpreted"
    elastic: bool = False
    chunks: dict[int, Chunk] = field(default_factory=dict)

    @cached_property
    def whole(self) -> bool:
        """True if everything is recorded."""
        size = self.step.tick.numel_out(0) + self.step.tick.numel_out(1)
        return np.array_equal(self.kept, np.arange(size))

    def advance(self, state: np.ndarray, p: np.ndarray, first: int, ticks: int, rows: np.ndarray) -> int:
        """See `Engine`."""
        if ticks == 0:
            self._keep(state[None], self._observed(state[None], p, first), first, rows)
            return 0
        if ticks not in self.chunks:
            self.chunks[ticks] = Chunk(self.step.tick, ticks)
        try:
            states, recorded = self.chunks[ticks](state, self.step.instants.rows(first, ticks), p)
        except RuntimeError as error:  # raised by CasADi if an adaptive integrator fails
            states = self._singly(state, p, first, ticks)
            self._keep(states, self._observed(states, p, first), first, rows)
            state[:] = states[-1]
            raise Stuck(len(states) - 1, str(error).strip().splitlines()[-1]) from None
        done = ticks
        within = np.all(np.abs(states[1:]) <= self.step.bounds, axis=1)  # False for NaN
        if not np.all(within):
            done = int(np.argmin(within))
        count = max(1, min(ticks, done + 1))
        self._keep(states, recorded[:count], first, rows)
        state[:] = states[min(done + 1, ticks)]
        return done

    def _singly(self, state: np.ndarray, p: np.ndarray, first: int, ticks: int) -> np.ndarray:
        """Repeat a failed chunk tick by tick, up to the failing one."""
        states = [state.copy()]
        try:
            for given in self.step.instants.rows(first, ticks):
                states.append(self.step.tick(states[-1], given, p)[0].full().ravel())
        except RuntimeError:
            pass
        return np.stack(states)

    def _observed(self, states: np.ndarray, p: np.ndarray, first: int) -> np.ndarray:
        """Recorded outputs at states, one row each, for the ticks from `first` on."""
        given = self.step.instants.rows(first, len(states))
        return np.stack([self.step.outputs(x, row, p).full().ravel() for x, row in zip(states, given, strict=True)])

    def _keep(self, states: np.ndarray, recorded: np.ndarray, first: int, rows: np.ndarray) -> None:
        """Write the recorded values of these ticks to `rows`."""
        wanted = slice(-first % self.every, None, self.every)
        both = np.hstack([states[: len(recorded)][wanted], recorded[wanted]])
        rows[: len(both)] = both if self.whole else both[:, self.kept]
