"""Processes on this machine: one a core, one thread each.

They are started as programs of their own, not by `multiprocessing`: that would import the user's script or notebook
once more in each, and where one is killed it cannot tell whose chunk was lost.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping
from contextlib import suppress
from queue import Empty, Queue
from types import TracebackType
from typing import IO, Any, Final, Protocol, final

from dmframe.errors import EngineError, visible
from dmframe.study.chunks import Chunk
from dmframe.study.computed import Computable, Computed, Failed, cores

Answer = tuple[Chunk, Computed | Failed]

_START: Final = (
    "import sys, pickle; sys.path[:] = pickle.load(sys.stdin.buffer); from dmframe.study.worker import serve; serve()"
)
_THREADS: Final = (
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "POLARS_MAX_THREADS",
)
_PATIENCE: Final = 5.0
"""How long a worker may take to end by itself [s]."""


class Workers(Protocol):
    """Where chunks are computed."""

    @property
    def count(self) -> int:
        """How many chunks are computed at once."""

    def submit(self, chunk: Chunk) -> None:
        """Let a chunk be computed."""

    def ended(self, timeout: float) -> Answer | None:
        """A chunk that has ended, after at most so long [s]; None where none has."""

    def __enter__(self) -> Workers:
        """Start them."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End them, whatever they do."""


@final
class Pool:
    """Worker processes on this machine, `Workers` that end with this process.

    Parameters
    ----------
    count
        How many; as many as there are cores without it.
    """

    def __init__(self, study: Computable, count: int | None = None) -> None:
        self._count = count or cores()
        self._study = pickle.dumps(study, protocol=pickle.HIGHEST_PROTOCOL)
        self._tasks: Queue[Chunk | None] = Queue()
        self._answers: Queue[Answer | EngineError] = Queue()
        self._processes: dict[int, _Worker] = {}
        self._closed = threading.Event()
        self._threads = [threading.Thread(target=self._serve, args=(i,), daemon=True) for i in range(self._count)]

    @property
    def count(self) -> int:
        """How many."""
        return self._count

    @property
    def processes(self) -> list[int]:
        """Their process numbers."""
        return [worker.process.pid for worker in list(self._processes.values())]

    def submit(self, chunk: Chunk) -> None:
        """Let a chunk be computed."""
        self._tasks.put(chunk)

    def ended(self, timeout: float) -> Answer | None:
        """A chunk that has ended. Raises `EngineError` where workers cannot be started."""
        try:
            answer = self._answers.get(timeout=timeout)
        except Empty:
            return None
        if isinstance(answer, EngineError):
            raise answer
        return answer

    def __enter__(self) -> Pool:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closed.set()
        for _place in self._threads:
            self._tasks.put(None)
        for worker in list(self._processes.values()):
            worker.process.kill()  # what is half computed is computed again, whenever that is
        for thread in self._threads:
            thread.join(_PATIENCE)

    def _serve(self, place: int) -> None:
        """Keep one worker busy; where it ends, say so of its chunk, and start another."""
        worker: _Worker | None = None
        try:
            while (chunk := self._tasks.get()) is not None and not self._closed.is_set():
                try:
                    if worker is None:
                        worker = self._processes[place] = _Worker(self._study)
                        if self._closed.is_set():  # it was started too late to be killed with the others
                            return
                        worker.begin()
                    answer = worker.ask(chunk)
                except EngineError as error:
                    self._answers.put(error)
                    return
                except _Ended as ended:
                    worker, answer = None, Failed(str(ended))
                self._answers.put((chunk, answer))
        finally:
            if worker is not None:
                worker.end()


class _Ended(Exception):
    """A worker that ended over a chunk."""


@final
class _Worker:
    """One process, and the two pipes to it."""

    def __init__(self, study: bytes) -> None:
        self._study = study
        self._said: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - it lives as long as the process
        self.process = subprocess.Popen(
            [sys.executable, "-c", _START],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            env=_environment(),
        )

    def begin(self) -> None:
        """Send it the study. Raises `EngineError` where it cannot work."""
        try:
            self._send([path or os.getcwd() for path in sys.path])  # noqa: PTH109 - a text
            self._send(self._study)
            self._receive()
        except (OSError, EOFError, pickle.UnpicklingError):
            raise EngineError(f"study: a worker process could not be started: {self._last_words()}") from None

    def ask(self, chunk: Chunk) -> Computed | Failed:
        """Have a chunk computed. Raises `_Ended`."""
        try:
            self._send(chunk)
            answer = self._receive()
        except (OSError, EOFError, pickle.UnpicklingError):
            raise _Ended(f"its process was ended: {self._last_words()}") from None
        assert isinstance(answer, Computed | Failed)  # that is what `serve` answers
        return answer

    def end(self) -> None:
        """Let it end by itself, which it does when nothing more can come; or end it."""
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with suppress(OSError):  # it has gone already
                    pipe.close()
        try:
            self.process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._said.close()

    def _send(self, what: object) -> None:
        assert self.process.stdin is not None  # it was asked for
        pickle.dump(what, self.process.stdin, protocol=pickle.HIGHEST_PROTOCOL)
        self.process.stdin.flush()

    def _receive(self) -> Any:
        assert self.process.stdout is not None  # it was asked for
        return pickle.load(self.process.stdout)

    def _last_words(self) -> str:
        status = self.process.wait()
        self._said.seek(0)
        lines = self._said.read().decode("utf-8", "replace").strip().splitlines()
        self.end()
        if status == -getattr(signal, "SIGKILL", 0):
            return "killed, as by a system that runs out of memory"
        if status < 0:
            return f"signal {-status}"
        return visible(lines[-1]) if lines else f"exit status {status}"


def _environment() -> Mapping[str, str]:
    return {**os.environ, **dict.fromkeys(_THREADS, "1")}
