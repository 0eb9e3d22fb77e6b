"""Reliable Ctrl-C during the construction of expressions: CasADi may clear exceptions, including interrupts."""

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
"""Interval at which a cleared interrupt is raised again [s]."""

_ENDING: Final = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


def in_child(renew: Callable[[], None]) -> None:
    """Register a function to run in each fork of this process, in which locks of other threads stay locked."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=renew)


def _renew_properties() -> None:
    """Renew the lock of each `cached_property` of the framework, which Python 3.11 has and other threads may hold.

    It takes some milliseconds, if there were other threads.
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
    """Reentrant lock within which an interrupt cannot be lost.

    An interrupt during a call of CasADi may be cleared there, so that the work continues, or ends with a wrong error.
    In the main thread it is therefore raised again periodically until it propagates, and at the latest when the lock is
    released, in place of any other exception.

    Code under the lock must not catch an interrupt and continue.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._depth, self._came = 0, False
        self._before = dict[int, Any]()
        in_child(self._renew)

    def _renew(self) -> None:
        """In a fork: a free lock, unless the forking thread, which continues in the fork, owns it."""
        if not self._lock._is_owned():  # type: ignore[attr-defined]  # also for a thread that has just taken it
            self._lock, self._depth = threading.RLock(), 0
            self._rest()

    def __enter__(self) -> None:
        self._lock.acquire()
        self._depth += 1
        if self._depth == 1 and threading.current_thread() is threading.main_thread():
            self._came = False
            for number in _ENDING:
                if callable(old := signal.getsignal(number)):
                    self._before[number] = signal.signal(number, self._wrapped(old))

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

    def _wrapped(self, old: Callable[[int, Any], Any]) -> Callable[[int, Any], None]:
        def handler(number: int, frame: Any) -> None:
            try:
                old(number, frame)  # a handler that defers signals, while files are written, does not raise
            except KeyboardInterrupt:
                self._came = True
                self._insist()
                raise

        return handler

    def _insist(self) -> None:
        if not hasattr(signal, "setitimer") or signal.getsignal(signal.SIGALRM) is not signal.SIG_DFL:
            return  # keep another alarm; the interrupt is still raised at the end of the work
        self._before[signal.SIGALRM] = signal.signal(signal.SIGALRM, self._alarm)
        signal.setitimer(signal.ITIMER_REAL, AGAIN, AGAIN)

    def _alarm(self, number: int, frame: Any) -> None:
        if not isinstance(sys.exc_info()[1], KeyboardInterrupt):  # else it propagates already
            raise KeyboardInterrupt

    def _rest(self) -> bool:
        """Restore the signal handlers; return whether an interrupt came."""
        if self._came and hasattr(signal, "setitimer") and signal.SIGALRM in self._before:
            signal.setitimer(signal.ITIMER_REAL, 0)
        while self._before:
            signal.signal(*self._before.popitem())
        came, self._came = self._came, False
        return came
