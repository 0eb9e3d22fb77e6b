"""Work that two processes share: drawing, which holds Python's lock, on two cores."""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

T = TypeVar("T")

_MOST = 200
"""Jobs that are shared; their numbers go through a pipe as bytes."""


@contextmanager
def shared(jobs: Sequence[Callable[[], T]]) -> Iterator[Callable[[], list[T]]]:
    """Begin with jobs in a copy of this process; what is yielded does those that are left, and returns all results.

    So the copy works while this process does something else. Where the system has no copies that can be trusted, or one
    core, all jobs are done at that call. What fails in the copy is done again here, so that it is told as if there were
    none. A copy whose results nobody asks for is ended.
    """
    alone = threading.active_count() == 1  # a copy holds the locks of threads that it has not
    if not (alone and 1 < len(jobs) < _MOST and sys.platform == "linux" and len(os.sched_getaffinity(0)) > 1):
        yield lambda: [job() for job in jobs]
        return
    numbers, writer = os.pipe()
    os.write(writer, bytes(range(len(jobs))))
    os.close(writer)
    told, here, ended = os.memfd_create("results"), os.getpid(), list[int]()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads of libraries: the copy draws, and calls none
        copy = os.fork()
    if copy == 0:
        _work(jobs, numbers, told, here)

    def finished() -> list[T]:
        done = _taken(jobs, numbers, lambda: True)
        ended.append(os.waitpid(copy, 0)[1])
        if ended == [0]:
            os.lseek(told, 0, os.SEEK_SET)
            with open(told, "rb", closefd=False) as file:
                done |= pickle.load(file)
        return [done[number] if number in done else job() for number, job in enumerate(jobs)]

    try:
        yield finished
    finally:
        if not ended:
            with suppress(ProcessLookupError):
                os.kill(copy, signal.SIGKILL)
            os.waitpid(copy, 0)
        os.close(numbers)
        os.close(told)


def _taken(jobs: Sequence[Callable[[], T]], numbers: int, going: Callable[[], bool]) -> dict[int, T]:
    """The results of the jobs whose numbers this process took."""
    done = dict[int, T]()
    while going() and (number := os.read(numbers, 1)):
        done[number[0]] = jobs[number[0]]()
    return done


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
