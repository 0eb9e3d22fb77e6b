"""The engines that run a closed loop: one written out as C and compiled, one interpreted by CasADi."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, final, get_args

import numpy as np

from dmframe.compile import first_time, load, loop_source
from dmframe.compile.library import address
from dmframe.errors import EngineError, ValueFault
from dmframe.simulate.step import Solver, Step

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
    def name(self) -> str:
        """As `Run.engine` tells it."""

    @property
    def notices(self) -> tuple[str, ...]:
        """What a user should know of the choice."""

    @property
    def elastic(self) -> bool:
        """May a chunk be of any size?"""

    def advance(self, state: np.ndarray, p: np.ndarray, first: int, ticks: int, rows: np.ndarray) -> int:
        """Advance `state` in place by `ticks` ticks, and write what is kept to `rows`.

        Returns how many ticks ended with a finite state: the next one's state is left where that is fewer. Of no
        ticks at all, the one row of `first` is written.
        """


def choose(choice: Choice, step: Step, solver: Solver, every: int, kept: np.ndarray, ticks: int) -> Engine:
    """The engine for a run of so many ticks, or of several that are so many together."""
    if choice not in get_args(Choice):
        raise ValueFault(f"engine: expected {', '.join(get_args(Choice))}, found {choice!r}", path=("engine",))
    wanted = choice == "compiled" or (choice == "auto" and solver.method == "rk4" and ticks * _work(step) > WORTH)
    notices = list[str]()
    if wanted and solver.method != "rk4":
        notices.append(f"engine: {solver.method} runs interpreted; solver.method rk4 can be compiled")
    elif wanted:
        found, notice = _compiled(step)
        if notice is not None and (first_time(notice) or choice == "compiled"):
            notices.append(notice)
        if found is not None:
            return Compiled(step, kept, every, found, tuple(notices))
    return Interpreted(step, kept, every, tuple(notices))


def _work(step: Step) -> int:
    """Instructions in a tick."""
    parts = step.parts
    return int(
        parts.control.n_instructions()
        + parts.outputs.n_instructions()
        + 4 * step.substeps * parts.rate.n_instructions()
    )


def _compiled(step: Step) -> tuple[Any, str | None]:
    try:
        loaded = load(loop_source(step.parts))
    except EngineError as error:
        return None, error.text
    if loaded.library is None:
        return None, loaded.notice
    run = loaded.library.dm_run
    run.restype = ctypes.c_int64
    return run, loaded.notice


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
        return int(
            self.run(
                address(state),
                address(p),
                ctypes.c_double(self.step.period),
                whole(self.step.substeps),
                whole(first),
                whole(ticks),
                whole(self.every),
                address(self.kept),
                whole(self.kept.size),
                address(rows),
            )
        )


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
    chunks: dict[int, Any] = field(default_factory=dict)
    maps: dict[int, Any] = field(default_factory=dict)

    def advance(self, state: np.ndarray, p: np.ndarray, first: int, ticks: int, rows: np.ndarray) -> int:
        """See `Engine`."""
        try:
            history = self._history(state, p, first, ticks)
        except RuntimeError as error:  # CasADi's, for an adaptive integrator that gives up
            history = self._singly(state, p, first, ticks)
            self._keep(history, p, first, history.shape[1], rows)
            state[:] = history[:, -1]
            raise Stuck(history.shape[1] - 1, str(error).strip().splitlines()[-1]) from None
        bad = np.flatnonzero(~np.all(np.isfinite(history), axis=0))
        done = int(bad[0]) - 1 if bad.size else ticks
        self._keep(history, p, first, max(1, min(ticks, done + 1)), rows)
        state[:] = history[:, min(done + 1, ticks)]
        return done

    def _history(self, state: np.ndarray, p: np.ndarray, first: int, ticks: int) -> np.ndarray:
        """States at the ticks first to first + ticks, a column each."""
        if ticks == 0:
            return state[:, None]
        if ticks not in self.chunks:
            self.chunks[ticks] = self.step.tick.mapaccum(f"ticks_{ticks}", ticks)
        many = self.chunks[ticks](state, np.arange(first, first + ticks)[None, :], p).full()
        return np.hstack([state[:, None], many])

    def _singly(self, state: np.ndarray, p: np.ndarray, first: int, ticks: int) -> np.ndarray:
        """Go again through the ticks of a chunk that failed, up to the one that cannot be computed."""
        columns = [state.copy()]
        try:
            for k in range(first, first + ticks):
                columns.append(self.step.tick(columns[-1], k, p).full().ravel())
        except RuntimeError:
            pass
        return np.stack(columns, axis=1)

    def _keep(self, history: np.ndarray, p: np.ndarray, first: int, count: int, rows: np.ndarray) -> None:
        """Write what is kept of the first `count` columns."""
        offset = -first % self.every
        states = history[:, offset : count : self.every]
        size = states.shape[1]
        if size == 0:
            return
        if size not in self.maps:
            self.maps[size] = self.step.outputs.map(size)
        times = (first + offset + self.every * np.arange(size)) * self.step.period
        outputs = self.maps[size](states, times[None, :], np.tile(p[:, None], size)).full()
        rows[:size] = np.vstack([states, outputs])[self.kept].T
