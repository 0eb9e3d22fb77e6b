"""Ctrl-C while expressions are made: CasADi clears what Python raises below it, an interrupt too."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Any, Final, final

AGAIN: Final = 0.3
"""After so many seconds an interrupt that has been cleared is raised anew [s]."""

_ENDING: Final = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


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
