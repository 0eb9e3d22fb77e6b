"""Executor with worker processes on this machine: one per core, each with one thread.

The workers are separate programs, not processes of `multiprocessing`: that would import the user's script or notebook
again in each, and could not report which chunk a killed worker was computing. A worker ends when its connection does,
so that none outlives this process.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
from collections import deque
from contextlib import suppress
from multiprocessing.connection import Connection, Pipe, wait
from queue import SimpleQueue
from typing import IO, Any, Final, final

from dmframe.common.cores import cores
from dmframe.common.errors import EngineError, visible
from dmframe.study.chunks import Chunk
from dmframe.study.executor import Answer, Computable, Executor, Failed, compute

_START: Final = """\
import sys
from multiprocessing.connection import Connection
pipe = Connection(int(sys.argv[1]))
sys.path[:] = pipe.recv()
from dmframe.study.pool import serve
serve(pipe)
"""
_READY: Final = "ready"
_THREADS: Final = (
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "POLARS_MAX_THREADS",
)
_LOST: Final = (OSError, EOFError, pickle.UnpicklingError)
"""Errors of a connection whose other end has ended."""


@final
class Pool(Executor):
    """Worker processes on this machine; as many as there are cores if `count` is None."""

    def __init__(self, study: Computable, count: int | None = None) -> None:
        self._count = count or cores()
        self._study = pickle.dumps(study, protocol=pickle.HIGHEST_PROTOCOL)
        self._workers = list[_Worker]()
        self._waiting = deque[Chunk]()
        self._answers = deque[Answer]()

    @property
    def count(self) -> int:
        """Number of workers."""
        return self._count

    @property
    def processes(self) -> list[int]:
        """Process numbers of the workers."""
        return [worker.process.pid for worker in self._workers]

    def submit(self, chunk: Chunk) -> None:
        """Queue a chunk."""
        self._waiting.append(chunk)
        self._distribute()

    def ended(self, timeout: float) -> Answer | None:
        """A finished chunk. Raises `EngineError` if a worker cannot be started."""
        if not self._answers:
            ready = wait([worker.pipe for worker in self._workers], timeout)
            for worker in [each for each in self._workers if each.pipe in ready]:
                self._read(worker)
            self._distribute()
        return self._answers.popleft() if self._answers else None

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.process.kill()  # its chunk is computed again by the next call
        for worker in self._workers:
            worker.close()

    def _distribute(self) -> None:
        """Give a waiting chunk to each idle worker; start another one if all are busy and there may be more."""
        while self._waiting:
            worker = next((each for each in self._workers if each.chunk is None), None)
            if worker is None:
                if len(self._workers) == self._count:
                    return
                self._workers.append(worker := _Worker(self._study))
            worker.chunk = self._waiting.popleft()
            with suppress(*_LOST):  # its end is found by `_read`
                worker.pipe.send(worker.chunk)

    def _read(self, worker: _Worker) -> None:
        """Read the answer of a worker; if the worker has ended, its chunk failed."""
        chunk = worker.chunk
        try:
            answer = worker.pipe.recv()
        except _LOST:
            self._workers.remove(worker)
            reason = worker.close()
            if not worker.ready:
                raise EngineError(f"study: a worker process could not be started: {reason}") from None
            answer = Failed(f"its process was ended: {reason}")
        if answer == _READY:
            worker.ready = True
        elif chunk is not None:
            self._answers.append((chunk, answer))
            worker.chunk = None


@final
class _Worker:
    """One process, the connection to it, and the chunk that it computes."""

    def __init__(self, study: bytes) -> None:
        self.pipe, theirs = Pipe()
        self.chunk: Chunk | None = None
        self.ready = False
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - it lives as long as the process
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-c", _START, str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=self._errors,
                stderr=self._errors,
                pass_fds=[theirs.fileno()],
                env={**os.environ, **dict.fromkeys(_THREADS, "1")},
            )
        with suppress(*_LOST):  # as above
            self.pipe.send([path or os.getcwd() for path in sys.path])  # noqa: PTH109 - a text
            self.pipe.send_bytes(study)

    def close(self) -> str:
        """Close the connection, which ends the process; returns the reason if it had ended before."""
        self.pipe.close()
        status = self.process.wait()
        with self._errors as file:
            file.seek(0)
            lines = file.read().decode("utf-8", "replace").strip().splitlines()
        if status == -signal.SIGKILL:
            return "killed, possibly because memory ran out"
        if status < 0:
            return f"signal {-status}"
        return visible(lines[-1]) if lines else f"exit status {status}"


def serve(pipe: Connection) -> None:
    """Main function of a worker: read a pickled study, then compute chunks until the connection ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the parent process
    inbox = SimpleQueue[bytes]()
    threading.Thread(target=_listen, args=(pipe, inbox), daemon=True).start()
    try:
        study = pickle.loads(inbox.get())
    except Exception as error:
        sys.stderr.write(f"{type(error).__name__}: {' '.join(str(error).split())}\n")
        sys.stderr.flush()
        os._exit(1)  # a normal exit would wait for the listening thread
    _send(pipe, _READY)
    while True:
        _send(pipe, compute(study, pickle.loads(inbox.get())))


def _send(pipe: Connection, what: Any) -> None:
    try:
        pipe.send(what)
    except BrokenPipeError:
        os._exit(0)


def _listen(pipe: Connection, inbox: SimpleQueue[bytes]) -> None:
    """Read chunks in a thread, to notice the end of the connection while a chunk is computed."""
    while True:
        try:
            inbox.put(pipe.recv_bytes())
        except (EOFError, OSError):
            os._exit(0)
