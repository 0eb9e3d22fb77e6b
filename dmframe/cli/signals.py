"""Handle terminating signals like Ctrl-C, and defer them while results are written."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final

_ENDING: Final = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


@contextmanager
def stoppable() -> Iterator[None]:
    """Treat SIGTERM and SIGHUP like Ctrl-C."""

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    with _handled(stop, [number for number in _ENDING if signal.getsignal(number) is signal.SIG_DFL]):
        yield


@contextmanager
def deferred_signals() -> Iterator[list[int]]:
    """Store terminating signals instead of raising, so that a second Ctrl-C does not lose results."""
    came = list[int]()
    deferred = [number for number in (signal.SIGINT, *_ENDING) if signal.getsignal(number) is not signal.SIG_IGN]
    with _handled(lambda number, _: came.append(number), deferred):
        yield came


@contextmanager
def _handled(handler: Callable[[int, Any], None], numbers: list[int]) -> Iterator[None]:
    before = dict[int, Any]()
    try:
        if threading.current_thread() is threading.main_thread():  # Python restriction
            for number in numbers:
                before[number] = signal.signal(number, handler)
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, signal.SIG_DFL if old is None else old)
