"""Parallel jobs in forked processes, for work that holds Python's lock, such as drawing."""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Final, Generic, Protocol, TypeVar, final

from dmframe.common.cores import cores

T = TypeVar("T")


class Watcher(Protocol):
    """Notes what this process reads."""

    def start_in_copy(self) -> None:
        """Start to note in a forked process."""

    def noted(self) -> Any:
        """What the forked process noted since the last call; it can be pickled."""

    def adopt(self, noted: Any) -> None:
        """Note in this process what a forked one noted."""


watchers: Final = list[Watcher]()
"""The last one notes; what jobs of a forked process read is handed to it together with their results."""

_MOST = 200
"""Largest number of jobs; their numbers are bytes in a pipe."""

_PROCESSES = 4
"""Largest number of processes, including this one."""


@final
class Later(Generic[T]):
    """A value that jobs of `shared` wait for, since they start before it is known.

    A fork gets a pickled copy. If a job takes the value in this process, it was given before.
    """

    def __init__(self) -> None:
        self._given = list[T]()
        self._process, self._memory = os.getpid(), -1
        self._ends: tuple[int, int] | None = None

    def open(self) -> None:
        """Prepare to give the value to forks, which are started next."""
        self._memory, self._ends = os.memfd_create("later"), os.pipe()

    def give(self, value: T) -> None:
        """Give the value, once."""
        self._given.append(value)
        if self._ends is None:
            return
        try:
            with open(self._memory, "wb", closefd=False) as file:
                pickle.dump(value, file, protocol=5)
        except OSError:  # no memory: the forks end, and this process does their jobs
            os.close(self._ends[1])
            self._ends = (self._ends[0], os.dup(self._ends[0]))
        else:
            os.write(self._ends[1], bytes(_PROCESSES))

    def take(self) -> T:
        """The value; a fork waits for it.

        Raises
        ------
        EOFError
            The process that would give it has ended.
        """
        if not self._given:
            if self._ends is None or os.getpid() == self._process:
                raise EOFError("the value was not given")
            os.close(self._ends[1])  # else a fork whose parent has ended would wait forever
            if not os.read(self._ends[0], 1):
                raise EOFError("the process that gives the value has ended")
            size = os.fstat(self._memory).st_size
            self._given.append(pickle.loads(os.pread(self._memory, size, 0)))
        return self._given[0]

    def close(self) -> None:
        """Free what `open` took."""
        for end in self._ends or ():
            os.close(end)
        if self._memory >= 0:
            os.close(self._memory)
        self._memory, self._ends = -1, None


@contextmanager
def shared(
    jobs: Sequence[Callable[[], T]],
    *,
    busy: bool = False,
    small: bool = False,
    forks_only: bool = False,
    later: Sequence[Later[Any]] = (),
) -> Iterator[Callable[[], list[T]]]:
    """Start jobs in forked processes; the yielded function does the remaining ones, and returns all results.

    The forks work while this process does something else. If forks are not safe, or there is one core, or the jobs are
    `small`, shorter than a fork, that function does all jobs. A job that fails in a fork is repeated in this process,
    which raises its error. Forks are killed at the end of the ``with`` block. A `busy` process has other work as long
    as a job, and forks a single job too. With `forks_only`, this process waits for the forks, and does only what
    they did not. Jobs may wait for the values `later`.
    """
    count = min(_cores(), len(jobs) + busy, _PROCESSES) - 1 if len(jobs) < _MOST and not small else 0
    if count < 1:
        yield lambda: [job() for job in jobs]
        return
    copies, pipe = list[_Copy](), list[int]()
    try:
        for value in later:
            value.open()
        pipe += os.pipe()
        os.write(pipe[1], bytes(range(len(jobs))))
        os.close(pipe.pop())
        for _ in range(count):
            copies.append(_Copy.of(jobs, pipe[0]))
    except OSError:  # no pipe, memory or process: this process does the remaining jobs
        if len(pipe) != 1:
            for end in pipe:
                os.close(end)
            for value in later:
                value.close()
            yield lambda: [job() for job in jobs]
            return
    (numbers,) = pipe

    def finished() -> list[T]:
        done = {} if forks_only else dict(_taken(jobs, numbers))
        for copy in copies:
            done |= copy.results()
        return [done[number] if number in done else job() for number, job in enumerate(jobs)]

    try:
        yield finished
    finally:
        for copy in copies:
            copy.end()
        os.close(numbers)
        for value in later:
            value.close()


def _cores() -> int:
    """Number of cores for forks; 1 if a fork is not safe."""
    alone = threading.active_count() == 1  # a fork keeps the locks of threads that it does not have
    return cores() if alone and sys.platform == "linux" else 1


@final
@dataclass
class _Copy:
    """A forked process, and the memory for its results."""

    process: int
    memory: int
    ended: bool = False

    @classmethod
    def of(cls, jobs: Sequence[Callable[[], Any]], numbers: int) -> _Copy:
        """Fork a process that starts with the jobs; an interrupt from the terminal is left to this process."""
        memory, here = os.memfd_create("results"), os.getpid()
        unblocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            with warnings.catch_warnings():
                warnings.simplefilter(
                    "ignore", DeprecationWarning
                )  # of libraries' threads, which the fork does not use
                process = os.fork()
            if process == 0:
                _work(jobs, numbers, memory, here)
        except OSError:
            os.close(memory)
            raise
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, unblocked)
        return cls(process, memory)

    def results(self) -> dict[int, Any]:
        """Wait for the process, and return its results by the jobs' numbers, up to a job with which it ended.

        A result that cannot be read is left out, with those after it.
        """
        self._wait()
        self.ended, found = True, dict[int, Any]()
        with suppress(Exception), open(self.memory, "rb", closefd=False) as file:
            file.seek(0)
            while True:  # to the end of the file; a pickled object may raise anything
                number, result, noted = pickle.load(file)
                for watcher in watchers[-1:]:
                    watcher.adopt(noted)
                found[number] = result
        return found

    def end(self) -> None:
        """Kill the process, if it runs."""
        if not self.ended:
            with suppress(ProcessLookupError):
                os.kill(self.process, signal.SIGKILL)
            self._wait()
        os.close(self.memory)

    def _wait(self) -> None:
        """Wait for the end; a program that ignores SIGCHLD has no status of its children."""
        with suppress(ChildProcessError):
            os.waitpid(self.process, 0)


def _taken(
    jobs: Sequence[Callable[[], T]], numbers: int, going: Callable[[], bool] = lambda: True
) -> Iterator[tuple[int, T]]:
    """Take job numbers from the pipe; yields each with its job's result."""
    while going() and (number := _number(numbers)):
        yield number[0], jobs[number[0]]()


def _number(numbers: int) -> bytes:
    """Number of the next job; empty if the pipe fails, after which the parent does the remaining jobs."""
    try:
        return os.read(numbers, 1)
    except OSError:
        return b""


def _work(jobs: Sequence[Callable[[], Any]], numbers: int, memory: int, parent: int) -> None:
    """In the fork: take jobs while there are some and the parent lives; exit without cleanup handlers."""
    status = 1
    try:
        for watcher in watchers[-1:]:
            watcher.start_in_copy()
        with open(memory, "wb", buffering=0, closefd=False) as file:
            for number, result in _taken(jobs, numbers, lambda: os.getppid() == parent):
                noted = watchers[-1].noted() if watchers else None
                file.write(pickle.dumps((number, result, noted)))
        status = 0
    finally:
        os._exit(status)
