"""Work that copies of this process share: drawing, which holds Python's lock, on several cores."""

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
from typing import Any, TypeVar, final

T = TypeVar("T")

_MOST = 200
"""Jobs that are shared; their numbers go through a pipe as bytes."""

_PROCESSES = 4
"""At most, this one among them: each imports what it draws with by itself."""


@contextmanager
def shared(jobs: Sequence[Callable[[], T]]) -> Iterator[Callable[[], list[T]]]:
    """Begin with jobs in copies of this process; what is yielded does those that are left, and returns all results.

    So the copies work while this process does something else. Where the system has no copies that can be trusted, or
    one core, all jobs are done at that call. What fails in a copy is done again here, so that it is told as if there
    were none. Copies whose results nobody asks for are ended.
    """
    count = min(_cores(), len(jobs), _PROCESSES) - 1 if len(jobs) < _MOST else 0
    if count < 1:
        yield lambda: [job() for job in jobs]
        return
    copies, pipe = list[_Copy](), list[int]()
    try:
        pipe += os.pipe()
        os.write(pipe[1], bytes(range(len(jobs))))
        os.close(pipe.pop())
        for _ in range(count):
            copies.append(_Copy.of(jobs, pipe[0]))
    except OSError:  # no pipe, no memory, no process: what is left is done here
        if len(pipe) != 1:
            for end in pipe:
                os.close(end)
            yield lambda: [job() for job in jobs]
            return
    (numbers,) = pipe

    def finished() -> list[T]:
        done = _taken(jobs, numbers, lambda: True)
        for copy in copies:
            done |= copy.told()
        return [done[number] if number in done else job() for number, job in enumerate(jobs)]

    try:
        yield finished
    finally:
        for copy in copies:
            copy.end()
        os.close(numbers)


def _cores() -> int:
    """How many cores copies may use; one where a copy could not be trusted."""
    alone = threading.active_count() == 1  # a copy holds the locks of threads that it has not
    return len(os.sched_getaffinity(0)) if alone and sys.platform == "linux" else 1


@final
@dataclass
class _Copy:
    """A copy of this process, and the memory in which it leaves what it has done."""

    process: int
    memory: int
    ended: bool = False

    @classmethod
    def of(cls, jobs: Sequence[Callable[[], Any]], numbers: int) -> _Copy:
        """One that begins with the jobs."""
        memory, here = os.memfd_create("results"), os.getpid()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of libraries' threads: the copy draws, and calls none
            try:
                process = os.fork()
            except OSError:
                os.close(memory)
                raise
        if process == 0:
            _work(jobs, numbers, memory, here)
        return cls(process, memory)

    def told(self) -> dict[int, Any]:
        """Results by the jobs' numbers, of a copy that did all that it took; waits for it."""
        status, self.ended = os.waitpid(self.process, 0)[1], True
        if status:
            return {}
        try:
            os.lseek(self.memory, 0, os.SEEK_SET)
            with open(self.memory, "rb", closefd=False) as file:
                found: dict[int, Any] = pickle.load(file)
        except (OSError, EOFError, pickle.UnpicklingError):  # done again here
            return {}
        return found

    def end(self) -> None:
        """Nobody waits for it any longer."""
        if not self.ended:
            with suppress(ProcessLookupError):
                os.kill(self.process, signal.SIGKILL)
            os.waitpid(self.process, 0)
        os.close(self.memory)


def _taken(jobs: Sequence[Callable[[], T]], numbers: int, going: Callable[[], bool]) -> dict[int, T]:
    """The results of the jobs whose numbers this process took."""
    done = dict[int, T]()
    while going() and (number := _number(numbers)):
        done[number[0]] = jobs[number[0]]()
    return done


def _number(numbers: int) -> bytes:
    """The next job's; none from a pipe that fails: the jobs whose numbers are lost are done by whoever shared them."""
    try:
        return os.read(numbers, 1)
    except OSError:
        return b""


def _work(jobs: Sequence[Callable[[], Any]], numbers: int, told: int, parent: int) -> None:
    """The copy: take jobs as long as there are some and the parent lives; end without any of its farewells."""
    status = 1
    try:
        done = _taken(jobs, numbers, lambda: os.getppid() == parent)
        with open(told, "wb", closefd=False) as file:
            pickle.dump(done, file)
        status = 0
    finally:
        os._exit(status)
