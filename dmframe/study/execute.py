"""Run a study: cut it into chunks, have them computed, keep their rows; go on where another process was ended."""

from __future__ import annotations

import json
import platform
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, final

from dmframe.errors import OutputError, ValueFault
from dmframe.files import append, encoded, put, writing
from dmframe.study.beside import files_beside
from dmframe.study.chunks import WORK, Chunk, Extent, Sizes
from dmframe.study.cluster import Cluster, WorkersLost, exposed
from dmframe.study.computed import Computable, Computed, Failed, versions
from dmframe.study.pool import Pool, Workers
from dmframe.study.store import PROCESSES, PROVENANCE, Store, opened

ATTEMPTS: Final = 3
"""How often a chunk is tried."""
AHEAD: Final = 3
"""Chunks a worker that are submitted: one is computed, the others wait."""
_LOOK: Final = 0.5
"""How often somebody is told that nothing has changed [s]."""


@final
@dataclass
class State:
    """How far a study is.

    Attributes
    ----------
    runs, kept
        All runs, and those whose rows are there.
    computed
        Of these, those that were computed now.
    failed
        Why, by chunk, for chunks that failed as often as they are tried.
    lost
        Why it ended early; empty where it did not.
    notices
        What a user should know.
    seconds
        It has taken until now.
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
        """True where every row is there."""
        return self.kept == self.runs


Told = Callable[[State], None]


def run_study(
    study: Computable,
    out: str | Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    force: bool = False,
    chunk: int | None = None,
    told: Told | None = None,
    command: Sequence[str] | None = None,
) -> State:
    """Compute those rows of a study that its folder does not hold yet.

    Parameters
    ----------
    out
        The folder; one that was begun before is gone on with.
    workers
        Processes on this machine; as many as there are cores without it.
    scheduler
        Address of a dask scheduler, whose workers compute instead.
    force
        Where the folder holds another study, throw its runs away.
    chunk
        Samples a chunk; without it, as many as take some seconds.
    told
        Called with the state whenever it changes, and twice a second.
    command
        For the record; that of this process without it.

    Returns
    -------
    State
        With the chunks that failed `ATTEMPTS` times, if any, and why the workers were lost, if they were.

    Raises
    ------
    DmframeError
        Of the folder, see `opened`; or no worker can be started.
    """
    if workers is not None and workers < 1:
        raise ValueFault(f"workers: expected at least 1, found {workers}")
    if workers is not None and scheduler is not None:
        raise ValueFault("workers: the scheduler has its own; leave one of the two out")
    if chunk is not None and chunk < 1:
        raise ValueFault(f"chunk: expected at least 1 sample, found {chunk}")
    began, moment = time.monotonic(), datetime.now(UTC)
    state = State(study.runs)
    with opened(out, study, files_beside(study), force=force) as store:
        state.kept, state.notices = store.runs_done, [*store.notices, *exposed(scheduler or "")]
        each = store.each or (None if chunk is None else (1, chunk))

        def tell() -> None:
            state.seconds = time.monotonic() - began
            if told is not None:
                told(state)

        tell()
        if not state.complete:
            try:
                with _workers(study, workers, scheduler) as place:
                    sizes = Sizes(len(study.points), study.samples, extents=store.extents, each=each, work=WORK)
                    _Marching(store, place, state, tell).all(sizes)
            except WorkersLost as lost:
                state.lost = lost.text
            finally:
                state.seconds = time.monotonic() - began
                with suppress(OutputError):  # where the disk is full, that is told of the rows
                    _record(store, state, moment, scheduler, command)
        tell()
    return state


def _workers(study: Computable, workers: int | None, scheduler: str | None) -> Workers:
    if scheduler is None:
        return Pool(study, workers)
    return Cluster(study, scheduler)


@final
class _Marching:
    """The loop: chunks go out, a few a worker; rows come back and are kept."""

    def __init__(self, store: Store, workers: Workers, state: State, tell: Callable[[], None]) -> None:
        self._store, self._workers, self._state, self._tell = store, workers, state, tell
        self._out = set[Chunk]()
        self._again = list[Chunk]()
        self._alone = list[Chunk]()
        self._suspected = set[Chunk]()
        self._tried = Counter[Chunk]()

    def all(self, sizes: Sizes) -> None:
        """All chunks: those that are cut already, those that are timed, the rest."""
        store = self._store
        store.cut(sizes.extents, sizes.each)
        self._those(_left(store))
        while (probe := sizes.probe()) is not None:
            store.cut(sizes.extents, sizes.each)
            self._those(iter(probe))
            sizes.timed(probe, self._seconds(probe))
        store.cut(sizes.extents, sizes.each)
        self._those(_left(store))

    def _seconds(self, probe: Extent) -> float:
        """That a timed chunk took; where it failed, a guess that makes chunks small."""
        (chunk,) = probe
        kept = self._store.kept.get(self._store.file(chunk).name)
        return kept.seconds if kept else float(chunk.runs)

    def _those(self, chunks: Iterator[Chunk]) -> None:
        """Compute chunks: never more at once than keeps the workers busy, however many there are."""
        waiting = (chunk for chunk in chunks if chunk not in self._state.failed)
        while True:
            self._state.workers = self._workers.count
            while len(self._out) < AHEAD * max(self._workers.count, 1):
                chunk = self._again.pop() if self._again else next(waiting, None)
                if chunk is None:
                    break
                self._out.add(chunk)
                self._workers.submit(chunk)
            if not self._out:  # what may have been ended for another's sake comes last, and one by one
                if not self._alone:
                    return
                self._out.add(chunk := self._alone.pop())
                self._workers.submit(chunk)
            if (answer := self._workers.ended(_LOOK)) is not None:
                self._take(*answer)
            self._tell()

    def _take(self, chunk: Chunk, answer: Computed | Failed) -> None:
        self._out.discard(chunk)
        if isinstance(answer, Computed):
            try:
                self._store.write(chunk, answer)
            except ValueFault as fault:  # rows that are not those of the chunk
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
            self._again.append(chunk)


def _left(store: Store) -> Iterator[Chunk]:
    cut = list(store.extents)  # those that are timed come to it meanwhile
    return (chunk for extent in cut for chunk in extent if chunk not in store.done)


def _record(store: Store, state: State, moment: datetime, scheduler: str | None, command: Sequence[str] | None) -> None:
    """Say in ``provenance.json`` what ran last and what made the rows, and add this process to those before it."""
    this = {
        "time": moment.isoformat(timespec="seconds"),
        "command": list(sys.argv if command is None else command),
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
