"""Work that two processes share: drawing, which holds Python's lock, on two cores."""

from __future__ import annotations

import os
import sys
import threading
import warnings
from collections.abc import Callable, Sequence

_MOST = 200
"""Jobs that are shared; their numbers go through a pipe as bytes."""


def by_two(jobs: Sequence[Callable[[], None]]) -> None:
    """Run jobs that write files and return nothing, in any order, here and in a copy of this process.

    One after another where the system has no copies that can be trusted, or one core. What fails in the copy is done
    again here, so that it is told as if there were none.
    """
    alone = threading.active_count() == 1  # a copy holds the locks of threads that it has not
    if not (alone and 1 < len(jobs) < _MOST and sys.platform == "linux" and len(os.sched_getaffinity(0)) > 1):
        for job in jobs:
            job()
        return
    reader, writer = os.pipe()
    os.write(writer, bytes(range(len(jobs))))
    os.close(writer)
    here = os.getpid()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads of libraries: the copy draws, and calls none
        copy = os.fork()
    if copy == 0:
        _work(jobs, reader, here)
    try:
        while number := os.read(reader, 1):
            jobs[number[0]]()
    finally:
        os.close(reader)
        _, status = os.waitpid(copy, 0)
    if status:
        for job in jobs:
            job()


def _work(jobs: Sequence[Callable[[], None]], reader: int, parent: int) -> None:
    """The copy: take jobs as long as there are some and the parent lives; end without any of its farewells."""
    status = 1
    try:
        while (number := os.read(reader, 1)) and os.getppid() == parent:
            jobs[number[0]]()
        status = 0
    finally:
        os._exit(status)
