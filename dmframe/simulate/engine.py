"""The engines that run a closed loop: one written out as C and compiled, one interpreted by CasADi."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal, Protocol, final, get_args

import casadi as ca
import numpy as np

from dmframe.build import first_time, load
from dmframe.build.library import address
from dmframe.build.trial import called
from dmframe.codegen import loop_source
from dmframe.diagram.rosenbrock import ROS34PW2
from dmframe.errors import EngineError, ValueFault
from dmframe.simulate.step import FIXED, Solver, Step

Choice = Literal["auto", "compiled", "interpreted"]

WORTH = 50_000_000
"""Instructions that a run must take for `auto` to compile it: a fraction of a second when interpreted."""

CHUNK = 256
"""Ticks that the interpreter computes in one call."""


class Stuck(Exception):
    """An adaptive integrator gave up; `done` ticks of the chunk were computed."""

    def __init__(self, done: int, reason: str) -> None:
        super().__init__(reason)
        self.done = done


class Engine(Protocol):
    """Something that advances a closed loop."""

    @property
    def step(self) -> Step:
        """The tick that it computes."""

    @property
    def name(self) -> str:
        """As `Recording.engine` tells it."""

    @property
    def notices(self) -> tuple[str, ...]:
        """What a user should know of the choice."""

    @property
    def elastic(self) -> bool:
        """True for one that can compute any number of ticks in a call."""

    def advance(self, state: np.ndarray, p: np.ndarray, first: int, ticks: int, rows: np.ndarray) -> int:
        """Advance `state` in place by `ticks` ticks, and write what is kept to `rows`.

        Returns how many ticks ended with a state within bounds: the next one's is left where that is fewer. Of no
        ticks at all, the one row of `first` is written.
        """


def choose(choice: Choice, step: Step, solver: Solver, every: int, kept: np.ndarray, ticks: int) -> Engine:
    """The engine for a run of so many ticks, or of several that are so many together."""
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
    """True for so many ticks that compiling them saves time."""
    return ticks * _work(step) > WORTH


def _work(step: Step) -> int:
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
    try:
        loaded = load(loop_source(step.parts, implicit=step.implicit), lambda library: _works(library, step))
    except EngineError as error:
        return None, error.text
    if loaded.library is None:
        return None, loaded.notice
    run = loaded.library.dm_run
    run.restype = ctypes.c_int64
    return run, loaded.notice


SCALES: Final = (1.0, 1e-3, 1e-6)
"""Of the states at which a new library is tried, each another number; the first that stays tame."""
LAST_DIGITS: Final = 1e-11
"""By how much the states differ from which it is told what rounding does."""
TAME: Final = 1e9
"""Below it an interpreter's numbers are compared with."""


def _works(library: Path, step: Step) -> bool:
    """True where a new library gives the interpreter's numbers, over one tick from a random state."""
    parts = step.parts
    period = float(step.period) * 1e-3  # so short that nothing blows up
    count = parts.outputs.numel_out(0)
    brief = step.with_period(period)
    given = brief.instants.rows(0, 1)
    for scale in SCALES:  # a law that takes differences over a period makes large numbers of far ones, and rounding
        rng = np.random.default_rng(0)
        state, p = (rng.uniform(0.5, 1.5, parts.sample.numel_in(place)) for place in (0, 4))
        state *= scale
        told = brief.tick(state, given, p)
        if max(float(np.max(np.abs(item.full()), initial=0.0)) for item in told[:2]) < TAME:
            break
    kept = (state.size + np.arange(count)).tolist()
    found = called(
        library,
        "dm_run",
        [
            {"doubles": state.tolist()},
            {"doubles": p.tolist()},
            {"double": period},
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
    return alike([found[0][: state.size], found[3][:count]], lambda x: brief.tick(x, given, p)[:2], state)


def alike(found: Sequence[Any], told: Callable[[np.ndarray], Sequence[Any]], state: np.ndarray) -> bool:
    """True where a new library gives the interpreter's numbers, but for what rounding does to them.

    How much that is, the interpreter tells, from states that differ in their last digits: at a random state, where what
    should be positive is not, a law may lose most of them.
    """
    rng = np.random.default_rng(1)
    shaken = [told(state * (1 + LAST_DIGITS * rng.uniform(-1, 1, state.size))) for _ in range(3)]
    for place, theirs in enumerate(item.full().ravel() for item in told(state)):
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
    """Machine code; it runs without Python's lock, so that several threads may run at once."""

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
    """Some ticks as one function, called without converting arrays."""

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
        """States from `state` on, and what is recorded there, a row a tick; overwritten by the next call.

        There is one state more than is recorded.
        """
        for array, value in zip(self._given, (state, given.ravel(), p), strict=True):
            array[:] = value
        self._states[0] = state
        self._evaluate()
        return self._states, self._recorded


@final
@dataclass(frozen=True)
class Interpreted:
    """CasADi's own virtual machine."""

    step: Step
    kept: np.ndarray
    every: int
    notices: tuple[str, ...] = ()
    name: str = "interpreted"
    elastic: bool = False
    chunks: dict[int, Chunk] = field(default_factory=dict)

    @cached_property
    def whole(self) -> bool:
        """True where everything is kept."""
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
        except RuntimeError as error:  # CasADi's, for an adaptive integrator that gives up
            states = self._singly(state, p, first, ticks)
            self._keep(states, self._observed(states, p, first), first, rows)
            state[:] = states[-1]
            raise Stuck(len(states) - 1, str(error).strip().splitlines()[-1]) from None
        done = ticks
        sound = np.all(np.abs(states[1:]) <= self.step.bounds, axis=1)  # false for nan, too
        if not np.all(sound):
            done = int(np.argmin(sound))
        count = max(1, min(ticks, done + 1))
        self._keep(states, recorded[:count], first, rows)
        state[:] = states[min(done + 1, ticks)]
        return done

    def _singly(self, state: np.ndarray, p: np.ndarray, first: int, ticks: int) -> np.ndarray:
        """Go again through the ticks of a chunk that failed, up to the one that cannot be computed."""
        states = [state.copy()]
        try:
            for given in self.step.instants.rows(first, ticks):
                states.append(self.step.tick(states[-1], given, p)[0].full().ravel())
        except RuntimeError:
            pass
        return np.stack(states)

    def _observed(self, states: np.ndarray, p: np.ndarray, first: int) -> np.ndarray:
        """What is recorded at states, a row each, of the ticks from `first` on."""
        given = self.step.instants.rows(first, len(states))
        return np.stack([self.step.outputs(x, row, p).full().ravel() for x, row in zip(states, given, strict=True)])

    def _keep(self, states: np.ndarray, recorded: np.ndarray, first: int, rows: np.ndarray) -> None:
        """Write what is kept of these ticks, a row each."""
        wanted = slice(-first % self.every, None, self.every)
        both = np.hstack([states[: len(recorded)][wanted], recorded[wanted]])
        rows[: len(both)] = both if self.whole else both[:, self.kept]
