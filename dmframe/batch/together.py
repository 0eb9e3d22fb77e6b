"""Runs in lanes: which of them go side by side, and what their figures come to."""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Final, final

import numpy as np

from dmframe.batch.figures import Board, Figures
from dmframe.batch.lanes import PER_OUTPUT, Group, Lanes
from dmframe.results.metrics import EIGHTHS, eighth_of
from dmframe.simulate.instants import TIME
from dmframe.simulate.run import LATER, Prepared
from dmframe.simulate.step import FIXED, Step
from dmframe.simulate.stiffness import MOST_SLOPE, RK4_STEPS, stiffness

TICKS: Final = 16384
"""Ticks that a thread computes in one call: Ctrl-C is heard between calls."""

_STACK: Final = 16 * 2**20
"""Of a thread: vectors of numbers take more than some systems give [bytes]."""


@final
@dataclass(frozen=True)
class Ran:
    """What N runs came to.

    Parameters
    ----------
    figures
        (outputs, 8 + 4, N), as of `Group`.
    ended
        (N,), the tick after which a run left its bounds; -1 for one that did not.
    """

    figures: np.ndarray
    ended: np.ndarray

    @classmethod
    def empty(cls, outputs: int, runs: int) -> Ran:
        """To be written into."""
        return cls(np.full((outputs, PER_OUTPUT, runs), np.nan), np.full(runs, -1, dtype=np.int64))

    def of(self, runs: np.ndarray) -> Ran:
        """Some of them."""
        return Ran(self.figures[..., runs], self.ended[runs])

    def put(self, runs: np.ndarray, other: Ran) -> None:
        """Take others' figures for some of the runs."""
        self.figures[..., runs] = other.figures
        self.ended[runs] = other.ended


@final
@dataclass(frozen=True)
class Together:
    """Lanes, and all that is the same for the runs in them.

    Parameters
    ----------
    lanes
        Machine code for a step's method, where there is some.
    limits
        Of each output's absolute value.
    threads
        How many groups of runs are computed at once.
    """

    lanes: Callable[[Step], Lanes | None]
    prepared: Prepared
    limits: np.ndarray
    threads: int

    def run(self, p: np.ndarray, states: np.ndarray, speeds: np.ndarray, board: Board, runs: np.ndarray) -> np.ndarray:
        """Run the columns of p and states, and write their figures to these runs of the board.

        Runs that diverge are tried again at shorter steps before the loop is blamed; see `Prepared.complete`.

        Parameters
        ----------
        p, states
            (P, N) and (S, N).
        speeds
            (N,), how fast each run's plant moves by itself [1/s].

        Returns
        -------
        array
            Which of the N runs are too stiff for lanes, of which nothing is written.
        """
        kinds = self._kinds(p, states, speeds)
        fit = [(own, members) for own, members in kinds if self._lanes_of(own) is not None]
        for own, members in fit:
            fastest = members[np.argmax(speeds[members])]
            stiff = stiffness(own.step, own.solver, float(speeds[fastest]), states[:, fastest], p[:, fastest])
            board.notices.update(dict.fromkeys(stiff))
        self._tell(board, fit)
        with _threads(self.threads) as pool:
            ran = self._march(fit, p, states, pool)
            tried, better = self._again(fit, ran, p, states, pool)
        ran.put(better, tried)
        board.again[0] += better.size
        fits = np.concatenate([np.zeros(0, np.int64), *(members for _, members in fit)])
        self._write(board, runs[fits], ran.of(fits))
        return np.setdiff1d(np.arange(len(speeds)), fits)

    def _lanes_of(self, own: Prepared) -> Lanes | None:
        return self.lanes(own.step) if own.solver.method in FIXED else None

    def _kinds(self, p: np.ndarray, states: np.ndarray, speeds: np.ndarray) -> list[tuple[Prepared, np.ndarray]]:
        """Runs for which the same method and steps are chosen, together."""
        h, takes, chosen = self.prepared.step.length, self.prepared.solver.takes, dict[str, Prepared]()
        kinds = defaultdict[tuple[str, int], list[int]](list)
        made = dict[tuple[str, int], Prepared]()
        for run, speed in enumerate(speeds.tolist()):
            stiff = speed < MOST_SLOPE and h * speed > takes
            key = f"{takes / speed:.2g}" if stiff else ""
            own = chosen.get(key) or self.prepared.stepping(states[:, run], p[:, run], speed)
            if not key or (own.solver.method == "rk4" and h / float(key) <= RK4_STEPS):  # the speed alone decided
                chosen[key] = own
            kind = (own.solver.method, own.step.substeps)
            kinds[kind].append(run)
            made.setdefault(kind, own)
        return [(made[kind], np.array(members)) for kind, members in kinds.items()]

    def _tell(self, board: Board, fit: Sequence[tuple[Prepared, np.ndarray]]) -> None:
        """What ran, and in which steps where these were chosen."""
        board.notices.update(dict.fromkeys((*self.prepared.notices, *self.prepared.keeping.notices)))
        for own, members in fit:
            lanes = self._lanes_of(own)
            assert lanes is not None  # it fits
            board.engines[lanes.name] = None
            if own.notices != self.prepared.notices:
                board.steps[own.solver.method].append((own.step.length, members.size))

    def _march(
        self, kinds: Sequence[tuple[Prepared, np.ndarray]], p: np.ndarray, states: np.ndarray, pool: ThreadPoolExecutor
    ) -> Ran:
        """All runs of each kind with its method and steps; of others nothing is told."""
        step, keeping = self.prepared.step, self.prepared.keeping
        groups = [
            (lanes, some, lanes.start(states[:, some], p[:, some], substeps))
            for lanes, some, substeps in self._side_by_side(kinds)
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
        ran = Ran.empty(self.limits.size, states.shape[1])
        for _, some, group in groups:
            ran.put(some, Ran(group.figures[..., : group.count], group.ended[: group.count]))
        return ran

    def _side_by_side(
        self, kinds: Sequence[tuple[Prepared, np.ndarray]]
    ) -> Iterator[tuple[Lanes, np.ndarray, np.ndarray]]:
        """Runs of one method that go in lanes together, and the steps of each: those of like steps, the shortest first.

        A group takes the time of its shortest steps; what is left over at the end takes the longest.
        """
        for method in dict.fromkeys(own.solver.method for own, _ in kinds):
            alike = [(own, members) for own, members in kinds if own.solver.method == method]
            runs = np.concatenate([members for _, members in alike])
            substeps = np.concatenate([np.full(members.size, own.step.substeps) for own, members in alike])
            lanes = self._lanes_of(alike[0][0])
            assert lanes is not None  # it fits
            order = np.argsort(-substeps, kind="stable")
            for first in range(0, order.size, lanes.width):
                some = order[first : first + lanes.width]
                yield lanes, runs[some], substeps[some]

    def _again(
        self,
        fit: Sequence[tuple[Prepared, np.ndarray]],
        ran: Ran,
        p: np.ndarray,
        states: np.ndarray,
        pool: ThreadPoolExecutor,
    ) -> tuple[Ran, np.ndarray]:
        """Runs that diverged, at shorter steps; and which of them the loop is not to be blamed for."""
        kinds = [(self.prepared.finer(own), members[ran.ended[members] >= 0]) for own, members in fit]
        wild = [(finer, members) for finer, members in kinds if finer is not None and members.size]
        tried = self._march(wild, p, states, pool)
        which = np.concatenate([np.zeros(0, np.int64), *(members for _, members in wild)])
        before, after = ran.ended[which], tried.ended[which]
        better = which[(after < 0) | (after + 1 >= LATER * (before + 1))]
        return tried.of(better), better

    def _write(self, board: Board, runs: np.ndarray, ran: Ran) -> None:
        """The figures of runs, by signal."""
        step, ticks = self.prepared.step, self.prepared.ticks
        board.diverged[runs] = np.where(ran.ended < 0, np.nan, (ran.ended + 1) * step.period)
        counts = self._counts(np.where(ran.ended < 0, ticks, ran.ended))
        with np.errstate(invalid="ignore", divide="ignore"):
            rms = np.where(counts > 0, np.sqrt(ran.figures[:, :EIGHTHS] / counts), np.nan).transpose(2, 0, 1)
        least, most, last, crossed = ran.figures[:, EIGHTHS:].transpose(1, 2, 0)
        crossed = np.where(crossed < 0, np.nan, crossed)
        first = 0
        for figures in board.signals.values():
            rows = slice(first, first + figures.last.shape[1])
            first = rows.stop
            figures.put(
                runs,
                Figures(figures.unit, rms[:, rows], least[:, rows], most[:, rows], last[:, rows], crossed[:, rows]),
            )

    def _counts(self, last: np.ndarray) -> np.ndarray:
        """(8, N): how many kept instants up to the tick `last` each eighth has."""
        step, every = self.prepared.step, self.prepared.keeping.every
        kept = np.arange(0, self.prepared.ticks + 1, every)
        part = eighth_of(step.instants.times(kept), self.prepared.ticks * step.period)
        begin, end = (np.searchsorted(part, np.arange(EIGHTHS), side) for side in ("left", "right"))
        return np.asarray(np.clip(last // every + 1 - begin[:, None], 0, (end - begin)[:, None]))


def _advance(
    item: tuple[Lanes, np.ndarray, Group], given: np.ndarray, first: int, parts: np.ndarray, limits: np.ndarray
) -> None:
    lanes, _, group = item
    lanes.advance(group, given, first, parts, limits)


@contextmanager
def _threads(count: int) -> Iterator[ThreadPoolExecutor]:
    """Threads with room for vectors; at Ctrl-C what they do ends, and no more begins."""
    before = threading.stack_size(_STACK)
    pool = ThreadPoolExecutor(count)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)
        threading.stack_size(before)
