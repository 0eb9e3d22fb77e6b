"""Ctrl-C while expressions are made: CasADi clears what Python raises below it, an interrupt too."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from functools import cached_property
from types import TracebackType
from typing import Any, Final, final

AGAIN: Final = 0.3
"""After so many seconds an interrupt that has been cleared is raised anew [s]."""

_ENDING: Final = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


def in_child(renew: Callable[[], None]) -> None:
    """Have something done in each copy of this process: a thread that holds a lock is not in the copy, its lock is."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=renew)


def _renew_properties() -> None:
    """Give each `cached_property` of the framework a free lock: Python 3.11 has one a property, which threads hold.

    It takes some milliseconds, where there were other threads.
    """
    if _threads[0] == 1:
        return
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] in _OWN and module is not None:
            for kind in [item for item in vars(module).values() if isinstance(item, type)]:
                for item in vars(kind).values():
                    if isinstance(item, cached_property) and hasattr(item, "lock"):
                        item.lock = threading.RLock()


def _count_threads() -> None:
    _threads[0] = threading.active_count()


_threads = [1]
if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_count_threads)
_OWN: Final = ("dmframe", "dmframe_blocks", "dmframe_plants")
in_child(_renew_properties)


@final
class Insistent:
    """A lock that one thread holds at a time, within which an interrupt cannot be lost.

    An interrupt that is raised inside a call of CasADi's may be cleared there, so that work goes on as if none had
    come, or ends in a fault that is none. In the main thread it is therefore raised again and again until it goes up,
    and at the latest where the lock is given back, in place of any other fault.

    What is done under it must not catch an interrupt to go on.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._depth, self._came = 0, False
        self._before = dict[int, Any]()
        in_child(self._renew)

    def _renew(self) -> None:
        """In a copy of this process: free, unless the thread that made the copy holds it and goes on here."""
        if not self._lock._is_owned():  # type: ignore[attr-defined]  # also of a thread that has just taken it
            self._lock, self._depth = threading.RLock(), 0
            self._rest()

    def __enter__(self) -> None:
        self._lock.acquire()
        self._depth += 1
        if self._depth == 1 and threading.current_thread() is threading.main_thread():
            self._came = False
            for number in _ENDING:
                if callable(old := signal.getsignal(number)):
                    self._before[number] = signal.signal(number, self._heard(old))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        came = False
        try:
            if self._depth == 1 and self._before:
                came = self._rest()
        finally:
            self._depth -= 1
            self._lock.release()
        if came and not isinstance(error, KeyboardInterrupt):
            raise KeyboardInterrupt from None

    def _heard(self, old: Callable[[int, Any], Any]) -> Callable[[int, Any], None]:
        def handler(number: int, frame: Any) -> None:
            try:
                old(number, frame)  # one that only notes it, while files are written, raises nothing
            except KeyboardInterrupt:
                self._came = True
                self._insist()
                raise

        return handler

    def _insist(self) -> None:
        if not hasattr(signal, "setitimer") or signal.getsignal(signal.SIGALRM) is not signal.SIG_DFL:
            return  # another one's alarm is left alone; the end of the work still tells
        self._before[signal.SIGALRM] = signal.signal(signal.SIGALRM, self._alarm)
        signal.setitimer(signal.ITIMER_REAL, AGAIN, AGAIN)

    def _alarm(self, number: int, frame: Any) -> None:
        if not isinstance(sys.exc_info()[1], KeyboardInterrupt):  # else it is on its way up, and things are put away
            raise KeyboardInterrupt

    def _rest(self) -> bool:
        """Leave signals as they were; tells whether an interrupt came."""
        if self._came and hasattr(signal, "setitimer") and signal.SIGALRM in self._before:
            signal.setitimer(signal.ITIMER_REAL, 0)
        while self._before:
            signal.signal(*self._before.popitem())
        came, self._came = self._came, False
        return came
