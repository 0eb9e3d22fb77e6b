"""Execution of a study: division into chunks, their computation, and storage of their rows; it can be resumed."""

from __future__ import annotations

import json
import platform
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from dmframe.common.cores import cores
from dmframe.common.errors import DmframeError, OutputError, ValueFault
from dmframe.common.files import append, encoded, put, writing
from dmframe.study.chunks import WORK, Chunk, Extent, Sizes
from dmframe.study.cluster import Cluster, WorkersLost, exposed
from dmframe.study.executor import Computed, Executor, Failed, compute, versions
from dmframe.study.journal import difference, entries_in, read_lock
from dmframe.study.pool import Pool
from dmframe.study.store import PROCESSES, PROVENANCE, Store, opened

if TYPE_CHECKING:
    from dmframe.study.plan import Study

ATTEMPTS: Final = 3
"""Attempts per chunk."""
AHEAD: Final = 3
"""Chunks submitted per worker: one is computed, the others are queued."""
_LOOK: Final = 0.5
"""Interval of progress reports without a change [s]."""


@final
@dataclass
class State:
    """Progress of a study.

    Attributes
    ----------
    runs, kept
        All runs, and those whose rows are in the folder.
    computed
        Runs computed by this call.
    failed
        Reason, by chunk, for chunks that failed in all attempts.
    lost
        Reason for an early end; empty without one.
    notices
        Warnings.
    seconds
        Elapsed time [s].
    """

    runs: int
    kept: int = 0
    computed: int = 0
    failed: dict[Chunk, str] = field(default_factory=dict)
    lost: str = ""
    notices: list[str] = field(default_factory=list)
    seconds: float = 0.0
    workers: int = 0

    @property
    def complete(self) -> bool:
        """True if every row is in the folder."""
        return self.kept == self.runs


def run_study(
    study: Study,
    out: str | Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    executor: Executor | None = None,
    force: bool = False,
    chunk: int | None = None,
    report: Callable[[State], None] | None = None,
) -> State:
    """Compute those rows of a study that its folder does not hold yet.

    Parameters
    ----------
    out
        Results folder; an existing one of the same study is continued.
    workers
        Processes on this machine; by default as many as there are cores.
    scheduler
        Address of a dask scheduler, whose workers compute instead.
    executor
        Executor to be used instead of these two, such as `InProcess`.
    force
        Delete the runs of another study in the folder.
    chunk
        Samples per chunk; by default as many as take some seconds.
    report
        Called with the state whenever it changes, and twice a second.

    Returns
    -------
    State
        With the chunks that failed `ATTEMPTS` times and, if the workers were lost, the reason.

    Raises
    ------
    DmframeError
        The folder cannot be used, see `opened`; or no worker can be started.
    """
    if workers is not None and workers < 1:
        raise ValueFault(f"workers: expected at least 1, found {workers}")
    if workers is not None and scheduler is not None:
        raise ValueFault("workers: not with a scheduler, which has its own workers; remove one of the two")
    if chunk is not None and chunk < 1:
        raise ValueFault(f"chunk: expected at least 1 sample, found {chunk}")
    began, moment = time.monotonic(), datetime.now(UTC)
    state = State(study.runs)
    with opened(out, study, study.files(), force=force) as store:
        state.kept, state.notices = store.runs_done, [*store.notices, *exposed(scheduler or "")]
        each = store.each or (None if chunk is None else (1, chunk))

        def update() -> None:
            state.seconds = time.monotonic() - began
            if report is not None:
                report(state)

        update()
        if not state.complete:
            try:
                executor = executor or (Pool(study, workers) if scheduler is None else Cluster(study, scheduler))
                with executor:
                    sizes = Sizes(len(study.points), study.samples, extents=store.extents, each=each, work=WORK)
                    _compute_all(Dispatcher(store.write, executor, state, update), store, sizes)
            except WorkersLost as lost:
                state.lost = lost.text
            finally:
                state.seconds = time.monotonic() - began
                with suppress(OutputError):  # a full disk is reported by the rows
                    _record(store, state, moment, scheduler)
        update()
    return state


def _compute_all(dispatcher: Dispatcher, store: Store, sizes: Sizes) -> None:
    """Compute all chunks: existing ones, those that are timed to choose the size, then the rest."""
    store.cut(sizes.extents, sizes.each)
    dispatcher.compute(_left(store))
    while (probe := sizes.probe()) is not None:
        store.cut(sizes.extents, sizes.each)
        dispatcher.compute(iter(probe))
        sizes.timed(probe, _seconds(store, probe))
    store.cut(sizes.extents, sizes.each)
    dispatcher.compute(_left(store))


def _seconds(store: Store, probe: Extent) -> float:
    """Duration of a timed chunk; after a failure, an estimate that gives small chunks."""
    (chunk,) = probe
    kept = store.kept.get(store.file(chunk).name)
    return kept.seconds if kept else float(chunk.runs)


@final
class Dispatcher:
    """Submits chunks, a few per worker, and writes the returned rows.

    Parameters
    ----------
    write
        Called with a chunk and its rows; raises `ValueFault` for rows of another chunk.
    update
        Called whenever the state changes, and twice a second.
    """

    def __init__(
        self,
        write: Callable[[Chunk, Computed], None],
        executor: Executor,
        state: State,
        update: Callable[[], None],
    ) -> None:
        self._write, self._executor, self._state, self._update = write, executor, state, update
        self._out = set[Chunk]()
        self._retry = list[Chunk]()
        self._alone = list[Chunk]()
        self._suspected = set[Chunk]()
        self._tried = Counter[Chunk]()

    def compute(self, chunks: Iterator[Chunk]) -> None:
        """Compute chunks, with at most `AHEAD` per worker submitted at a time."""
        waiting = (chunk for chunk in chunks if chunk not in self._state.failed)
        while True:
            self._state.workers = self._executor.count
            while len(self._out) < AHEAD * max(self._executor.count, 1):
                chunk = self._retry.pop() if self._retry else next(waiting, None)
                if chunk is None:
                    break
                self._out.add(chunk)
                self._executor.submit(chunk)
            if not self._out:  # chunks whose failure another one may have caused run last, one at a time
                if not self._alone:
                    return
                self._out.add(chunk := self._alone.pop())
                self._executor.submit(chunk)
            if (answer := self._executor.ended(_LOOK)) is not None:
                self._take(*answer)
            self._update()

    def _take(self, chunk: Chunk, answer: Computed | Failed) -> None:
        self._out.discard(chunk)
        if isinstance(answer, Computed):
            try:
                self._write(chunk, answer)
            except ValueFault as fault:  # rows of another chunk
                answer = Failed(fault.text, final=True)
            else:
                self._state.kept += chunk.runs
                self._state.computed += chunk.runs
                return
        if answer.alone and chunk not in self._suspected:
            self._suspected.add(chunk)
            self._alone.append(chunk)
            return
        self._tried[chunk] += 1
        if answer.final or answer.alone or self._tried[chunk] >= ATTEMPTS:
            self._state.failed[chunk] = answer.text
        else:
            self._retry.append(chunk)


def _left(store: Store) -> Iterator[Chunk]:
    extents = list(store.extents)  # timed chunks are added meanwhile
    return (chunk for extent in extents for chunk in extent if chunk not in store.done)


def _record(store: Store, state: State, moment: datetime, scheduler: str | None) -> None:
    """Update ``provenance.json`` with the last run and the origin of the rows, and append this process to the list."""
    this = {
        "time": moment.isoformat(timespec="seconds"),
        "command": sys.argv,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "versions": dict(versions()),
        "key": store.key,
        "seed": store.seed,
        "scheduler": scheduler,
        "workers": state.workers,
        "runs": state.computed,
        "seconds": round(state.seconds, 3),
    }
    made = {
        f"chunks by {what}": dict(Counter(kept.made.get(what, "") for kept in store.kept.values()))
        for what in ("processor", "engine", "host")
    }
    failed = {"failed": {str(chunk): why for chunk, why in state.failed.items()}} if state.failed else {}
    with writing(store.path, "folder"):
        put(store.path / PROVENANCE, encoded(json.dumps(this | made | failed, indent=2, ensure_ascii=False) + "\n"))
        append(store.path / PROCESSES, json.dumps(this | failed, ensure_ascii=False) + "\n")


@final
@dataclass(frozen=True)
class Estimate:
    """Estimate of a study's work.

    Parameters
    ----------
    kept
        Runs whose rows are in the folder.
    chunks, each
        Number of remaining chunks, and the runs of the largest.
    rate
        Runs per second of one worker on this machine.
    seconds
        Estimated time for the remaining chunks on `workers` workers.
    """

    points: int
    samples: int
    runs: int
    kept: int
    chunks: int
    each: int
    rate: float
    workers: int
    seconds: float

    @property
    def summary(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return asdict(self)


def estimate_of(study: Study, place: Path, workers: int | None = None) -> Estimate:
    """Divide a study into chunks without running it; if its folder has no timing, some runs are timed.

    Raises
    ------
    DmframeError
        The timed runs cannot be prepared.
    """
    lock = read_lock(place)
    mine = lock is not None and not difference(lock, study.identity)
    kept = entries_in(place) if mine else {}
    extents = [Extent(*numbers) for numbers in lock["extents"]] if lock and mine else []
    each = tuple(lock["each"]) if lock and mine and lock["each"] else None
    sizes = Sizes(len(study.points), study.samples, extents=extents, each=each)
    count, seconds = sum(line.rows for line in kept.values()), sum(line.seconds for line in kept.values())
    rate = count / seconds if seconds and each else _timed(study, sizes)
    left = [chunk for extent in sizes.extents for chunk in extent if f"{chunk.name(study.key)}.parquet" not in kept]
    many = workers or cores()
    return Estimate(
        points=len(study.points),
        samples=study.samples,
        runs=study.runs,
        kept=count,
        chunks=len(left),
        each=max((chunk.runs for chunk in left), default=0),
        rate=rate,
        workers=many,
        seconds=sum(chunk.runs for chunk in left) / rate / min(many, max(len(left), 1)),
    )


def _timed(study: Study, sizes: Sizes) -> float:
    """Find the size of chunks by timing some in this process; returns the runs per second."""
    rate = 1.0
    while (probe := sizes.probe()) is not None:
        (chunk,) = probe
        found = compute(study, chunk)
        if isinstance(found, Failed):
            raise DmframeError(f"{chunk}: {found.text}")
        sizes.timed(probe, found.seconds)
        rate = chunk.runs / max(found.seconds, 1e-9)
    return rate
