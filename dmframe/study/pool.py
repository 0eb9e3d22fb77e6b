"""Executor with worker processes on this machine: one per core, each with one thread.

The workers are separate programs, not processes of `multiprocessing`: that would import the user's script or notebook
again in each, and could not report which chunk a killed worker was computing. A worker reads chunks from standard input
and writes their rows to standard output; it ends when its input ends, so that no worker outlives this process.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
from contextlib import suppress
from queue import Empty, Queue, SimpleQueue
from typing import IO, TYPE_CHECKING, Any, Final, final

from dmframe.errors import EngineError, visible
from dmframe.simulate.many import cores
from dmframe.study.chunks import Chunk
from dmframe.study.executor import Answer, Computed, Failed, compute

if TYPE_CHECKING:
    from dmframe.study.plan import Study

_START: Final = (
    "import sys, pickle; sys.path[:] = pickle.load(sys.stdin.buffer); from dmframe.study.pool import serve; serve()"
)
_THREADS: Final = (
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "POLARS_MAX_THREADS",
)
_PATIENCE: Final = 5.0
"""Time for a worker to end by itself [s]."""


@final
class Pool:
    """Worker processes on this machine, an `Executor`; as many as there are cores if `count` is None."""

    def __init__(self, study: Study, count: int | None = None) -> None:
        self._count = count or cores()
        self._study = pickle.dumps(study, protocol=pickle.HIGHEST_PROTOCOL)
        self._tasks: Queue[Chunk | None] = Queue()
        self._answers: Queue[Answer | EngineError] = Queue()
        self._processes: dict[int, _Worker] = {}
        self._closed = threading.Event()
        self._threads = [threading.Thread(target=self._serve, args=(i,), daemon=True) for i in range(self._count)]

    @property
    def count(self) -> int:
        """Number of workers."""
        return self._count

    @property
    def processes(self) -> list[int]:
        """Process numbers of the workers."""
        return [worker.process.pid for worker in list(self._processes.values())]

    def submit(self, chunk: Chunk) -> None:
        """Queue a chunk."""
        self._tasks.put(chunk)

    def ended(self, timeout: float) -> Answer | None:
        """A finished chunk. Raises `EngineError` if a worker cannot be started."""
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
            worker.process.kill()  # its chunk is computed again by the next call
        for thread in self._threads:
            thread.join(_PATIENCE)

    def _serve(self, place: int) -> None:
        """Keep one worker busy; if it ends, report its chunk as failed and start another."""
        worker: _Worker | None = None
        try:
            while (chunk := self._tasks.get()) is not None and not self._closed.is_set():
                try:
                    if worker is None:
                        worker = self._processes[place] = _Worker(self._study)
                        if self._closed.is_set():  # started too late to be killed with the others
                            return
                        worker.begin()
                    answer = worker.compute(chunk)
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
    """A worker ended while it computed a chunk."""


@final
class _Worker:
    """One process, and two pipes to it."""

    def __init__(self, study: bytes) -> None:
        self._study = study
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - it lives as long as the process
        self.process = subprocess.Popen(
            [sys.executable, "-c", _START],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env={**os.environ, **dict.fromkeys(_THREADS, "1")},
        )

    def begin(self) -> None:
        """Send it the study. Raises `EngineError` if it cannot read it."""
        try:
            self._send([path or os.getcwd() for path in sys.path])  # noqa: PTH109 - a text
            self._send(self._study)
            self._receive()
        except (OSError, EOFError, pickle.UnpicklingError):
            raise EngineError(f"study: a worker process could not be started: {self._reason()}") from None

    def compute(self, chunk: Chunk) -> Computed | Failed:
        """Send a chunk and wait for its rows. Raises `_Ended`."""
        try:
            self._send(chunk)
            answer = self._receive()
        except (OSError, EOFError, pickle.UnpicklingError):
            raise _Ended(f"its process was ended: {self._reason()}") from None
        assert isinstance(answer, Computed | Failed)  # what `serve` sends
        return answer

    def end(self) -> None:
        """Close the pipes, upon which it ends by itself; else kill it."""
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with suppress(OSError):  # it has ended already
                    pipe.close()
        try:
            self.process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._errors.close()

    def _send(self, what: object) -> None:
        assert self.process.stdin is not None  # a pipe, see __init__
        pickle.dump(what, self.process.stdin, protocol=pickle.HIGHEST_PROTOCOL)
        self.process.stdin.flush()

    def _receive(self) -> Any:
        assert self.process.stdout is not None  # a pipe, see __init__
        return pickle.load(self.process.stdout)

    def _reason(self) -> str:
        status = self.process.wait()
        self._errors.seek(0)
        lines = self._errors.read().decode("utf-8", "replace").strip().splitlines()
        self.end()
        if status == -getattr(signal, "SIGKILL", 0):
            return "killed, as by a system that runs out of memory"
        if status < 0:
            return f"signal {-status}"
        return visible(lines[-1]) if lines else f"exit status {status}"


def serve() -> None:
    """Main function of a worker: read a pickled study, then compute chunks until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the parent process
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # keeps what a block prints out of the answers
    inbox = SimpleQueue[Any]()
    threading.Thread(target=_listen, args=(inbox,), daemon=True).start()
    try:
        study = pickle.loads(inbox.get())
    except Exception as error:
        sys.stderr.write(f"{type(error).__name__}: {' '.join(str(error).split())}\n")
        sys.stderr.flush()
        os._exit(1)  # a normal exit would wait for the listening thread
    _answer(answers, "ready")
    while True:
        _answer(answers, compute(study, inbox.get()))


def _answer(answers: Any, what: object) -> None:
    try:
        pickle.dump(what, answers, protocol=pickle.HIGHEST_PROTOCOL)
        answers.flush()
    except BrokenPipeError:
        os._exit(0)


def _listen(inbox: SimpleQueue[Any]) -> None:
    """Read chunks in a thread, to notice the end of the input while a chunk is computed."""
    while True:
        try:
            inbox.put(pickle.load(sys.stdin.buffer))
        except EOFError:
            os._exit(0)
        except pickle.UnpicklingError:  # truncated: the parent process was ended
            os._exit(1)
