"""Grouping of runs into SIMD batches by method and number of steps, and their figures."""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.batch.figures import CROSSED, PER_OUTPUT, FigureTable
from dmframe.batch.simd import Group, SimdLoop
from dmframe.results.metrics import EIGHTHS, eighth_of
from dmframe.simulate.instants import TIME
from dmframe.simulate.run import LATER, Prepared
from dmframe.simulate.solver import FIXED
from dmframe.simulate.step import Step
from dmframe.simulate.stiffness import MOST_SLOPE, RK4_STEPS, fastest, stiffness

TICKS: Final = 16384
"""Ticks per call of a thread; Ctrl-C takes effect between calls."""

_STACK: Final = 16 * 2**20
"""Stack of a thread: vector temporaries exceed the default of some systems [bytes]."""

Kinds = Sequence[tuple[Prepared, np.ndarray]]
"""Method and steps, each with the runs that use them."""


@final
@dataclass(frozen=True)
class SimdRunner:
    """Runs the columns of parameters and states in SIMD batches.

    Parameters
    ----------
    loops
        Machine code for a step's method, if it can be compiled.
    limits
        Limit of each output's absolute value.
    threads
        Number of concurrent batches.
    """

    loops: Callable[[Step], SimdLoop | None]
    prepared: Prepared
    limits: np.ndarray
    threads: int

    def run(
        self, p: np.ndarray, states: np.ndarray, speeds: np.ndarray, table: FigureTable, runs: np.ndarray
    ) -> np.ndarray:
        """Run the columns of p and states, and write their figures to these runs of the table.

        Diverged runs are repeated with shorter steps, which separates divergence of the loop from that of the
        integrator; see `Prepared.complete`.

        Parameters
        ----------
        p, states
            (P, N) and (S, N).
        speeds
            (N,), fastest rate of each run's plant [1/s].

        Returns
        -------
        array
            Indices of runs that are too stiff for a fixed-step method; their rows of the table are unchanged.
        """
        kinds = [(own, members) for own, members in self._kinds(p, states, speeds) if self._loop(own) is not None]
        for own, members in kinds:
            first = members[np.argmax(speeds[members])]
            stiff = stiffness(own.step, own.solver, float(speeds[first]), states[:, first], p[:, first])
            table.notices.update(dict.fromkeys(stiff))
        self._note(table, kinds)
        with _threads(self.threads) as pool:
            figures, ended = self._march(kinds, p, states, pool)
            table.repeated += self._repeat(kinds, figures, ended, p, states, pool)
        done = np.concatenate([np.zeros(0, np.int64), *(members for _, members in kinds)])
        table.diverged[runs[done]], table.data[runs[done]] = self._figures(figures[..., done], ended[done])
        return np.setdiff1d(np.arange(len(speeds)), done)

    def _loop(self, own: Prepared) -> SimdLoop | None:
        return self.loops(own.step) if own.solver.method in FIXED else None

    def _kinds(self, p: np.ndarray, states: np.ndarray, speeds: np.ndarray) -> list[tuple[Prepared, np.ndarray]]:
        """Runs grouped by method and number of integrator steps."""
        h, takes, chosen = self.prepared.step.length, self.prepared.solver.takes, dict[str, Prepared]()
        kinds = defaultdict[tuple[str, int], list[int]](list)
        made = dict[tuple[str, int], Prepared]()
        for run, speed in enumerate(speeds.tolist()):
            stiff = speed < MOST_SLOPE and h * speed > takes
            key = f"{takes / speed:.2g}" if stiff else ""
            own = chosen.get(key) or self.prepared.stepping(states[:, run], p[:, run], speed)
            if not key or (own.solver.method == "rk4" and h / float(key) <= RK4_STEPS):  # determined by the speed
                chosen[key] = own
            kind = (own.solver.method, own.step.substeps)
            kinds[kind].append(run)
            made.setdefault(kind, own)
        return [(made[kind], np.array(members)) for kind, members in kinds.items()]

    def _note(self, table: FigureTable, kinds: Kinds) -> None:
        """Record the engine, and the steps if they differ from the usual ones."""
        table.notices.update(dict.fromkeys((*self.prepared.notices, *self.prepared.keeping.notices)))
        for own, members in kinds:
            loop = self._loop(own)
            assert loop is not None  # by the choice of kinds
            table.engines[loop.name] = None
            if own.notices != self.prepared.notices:
                table.steps[own.solver.method].append((own.step.length, members.size))

    def _march(
        self, kinds: Kinds, p: np.ndarray, states: np.ndarray, pool: ThreadPoolExecutor
    ) -> tuple[np.ndarray, np.ndarray]:
        """Raw figures (outputs, `PER_OUTPUT`, N) of the runs of each kind, and the tick after which each diverged."""
        step, keeping = self.prepared.step, self.prepared.keeping
        groups = [
            (loop, some, loop.start(states[:, some], p[:, some], substeps))
            for loop, some, substeps in self._batches(kinds)
        ]
        ticks = self.prepared.ticks if groups else 0
        for first in range(0, ticks, TICKS):
            count = min(TICKS, ticks - first)
            given = step.instants.rows(first, count + 1)
            parts = eighth_of(given[:, TIME], ticks * step.period)
            parts[np.arange(first, first + count + 1) % keeping.every != 0] = -1
            parts[-1] = parts[-1] if first + count == ticks else -1
            run = partial(_advance, given=given, first=first, parts=parts, limits=self.limits)
            list(pool.map(run, groups))
        runs = states.shape[1]
        figures, ended = np.full((self.limits.size, PER_OUTPUT, runs), np.nan), np.full(runs, -1, dtype=np.int64)
        for _, some, group in groups:
            figures[..., some], ended[some] = group.figures[..., : group.count], group.ended[: group.count]
        return figures, ended

    def _batches(self, kinds: Kinds) -> Iterator[tuple[SimdLoop, np.ndarray, np.ndarray]]:
        """Groups of runs of one method that share a register, with their steps, sorted by number of steps.

        A batch takes as long as its run with most steps, so the incomplete batch has the fewest.
        """
        for method in dict.fromkeys(own.solver.method for own, _ in kinds):
            alike = [(own, members) for own, members in kinds if own.solver.method == method]
            runs = np.concatenate([members for _, members in alike])
            substeps = np.concatenate([np.full(members.size, own.step.substeps) for own, members in alike])
            loop = self._loop(alike[0][0])
            assert loop is not None  # by the choice of kinds
            order = np.argsort(-substeps, kind="stable")
            for first in range(0, order.size, loop.width):
                some = order[first : first + loop.width]
                yield loop, runs[some], substeps[some]

    def _repeat(
        self,
        kinds: Kinds,
        figures: np.ndarray,
        ended: np.ndarray,
        p: np.ndarray,
        states: np.ndarray,
        pool: ThreadPoolExecutor,
    ) -> int:
        """Repeat diverged runs with shorter steps; replace those in which only the integrator diverged."""
        finer = [(self.prepared.finer(own), members[ended[members] >= 0]) for own, members in kinds]
        repeated = [(own, members) for own, members in finer if own is not None and members.size]
        new_figures, new_ended = self._march(repeated, p, states, pool)
        which = np.concatenate([np.zeros(0, np.int64), *(members for _, members in repeated)])
        before, after = ended[which], new_ended[which]
        better = which[(after < 0) | (after + 1 >= LATER * (before + 1))]
        figures[..., better], ended[better] = new_figures[..., better], new_ended[better]
        return int(better.size)

    def _figures(self, raw: np.ndarray, ended: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Time of divergence (N,) and figures (N, outputs, `PER_OUTPUT`) from sums of squares."""
        period, ticks = self.prepared.step.period, self.prepared.ticks
        counts = self._counts(np.where(ended < 0, ticks, ended))
        found = raw.copy()
        with np.errstate(invalid="ignore", divide="ignore"):
            found[:, :EIGHTHS] = np.where(counts > 0, np.sqrt(raw[:, :EIGHTHS] / counts), np.nan)
        found[:, CROSSED] = np.where(raw[:, CROSSED] < 0, np.nan, raw[:, CROSSED])
        return np.where(ended < 0, np.nan, (ended + 1) * period), found.transpose(2, 0, 1)

    def _counts(self, last: np.ndarray) -> np.ndarray:
        """(8, N): number of recorded instants per eighth up to the tick `last`."""
        step, every = self.prepared.step, self.prepared.keeping.every
        kept = np.arange(0, self.prepared.ticks + 1, every)
        part = eighth_of(step.instants.times(kept), self.prepared.ticks * step.period)
        begin, end = (np.searchsorted(part, np.arange(EIGHTHS), side) for side in ("left", "right"))
        return np.asarray(np.clip(last // every + 1 - begin[:, None], 0, (end - begin)[:, None]))


def _advance(
    item: tuple[SimdLoop, np.ndarray, Group], given: np.ndarray, first: int, parts: np.ndarray, limits: np.ndarray
) -> None:
    loop, _, group = item
    loop.advance(group, given, first, parts, limits)


@contextmanager
def _threads(count: int) -> Iterator[ThreadPoolExecutor]:
    """A pool of threads with a stack for vectors; on Ctrl-C running calls finish and no more start."""
    before = threading.stack_size(_STACK)
    pool = ThreadPoolExecutor(count)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)
        threading.stack_size(before)


def slope_of(rate: Any) -> Any:
    """(state, p) -> Jacobian of the plant's rates with respect to its states, at t = 0; see `Step.rate`."""
    state, p = (ca.SX.sym(name, rate.numel_in(place)) for name, place in (("state", 0), ("p", 2)))
    size = rate.numel_out(0)
    flowing = state[state.numel() - size :]
    slope = ca.jacobian(rate.expand()(state, 0, p), flowing)
    return ca.Function("slope", [state, p], [ca.cse(ca.densify(slope))])


def speeds_of(slope: Any, states: np.ndarray, p: np.ndarray) -> np.ndarray:
    """(N,): fastest rate of the plant at each column of states and p [1/s], see `fastest`.

    Columns that agree in everything that the slope reads are computed once.
    """
    size, runs = slope.size1_out(0), states.shape[1]
    if not size or not runs:
        return np.zeros(runs)
    read = [np.unique(slope.jac_sparsity(0, place).get_triplet()[1]).astype(int) for place in (0, 1)]
    _, first, which = np.unique(
        np.vstack([states[read[0]], p[read[1]]]), axis=1, return_index=True, return_inverse=True
    )
    found = slope.map(first.size)(states[:, first], p[:, first]).full()
    return np.asarray(fastest(found.reshape(size, first.size, size).transpose(1, 0, 2))[which.ravel()])
