"""The bar of a long run, on standard error."""

from __future__ import annotations

import math
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final, final

from dmframe.common.errors import visible

if TYPE_CHECKING:  # rich is not imported if standard error is not displayed
    from rich.console import Console

    from dmframe.simulate.march import Progress as Bar

__all__ = ["Bar", "Bars", "counting", "progress_line", "shown"]

OFTEN: Final = 10.0
"""Least time between lines of progress that are kept [s]."""


def _aside() -> Console:
    """Standard error for literal text: names may contain characters that rich would interpret as markup.

    Where rich takes a text without its console (`TextColumn`, a status), markup has to be disabled there too.
    """
    from rich.console import Console

    return Console(stderr=True, markup=False, emoji=False, highlight=False)


def _progress(noun: str, **options: Any) -> Any:
    """Bars with a count of `noun`, a speed, the remaining time, and a note."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=30),
        TextColumn(f"{{task.completed:.0f}} / {{task.total:.0f}} {noun}"),
        TextColumn("{task.fields[speed]}"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}", markup=False),
        console=_aside(),
        **options,
    )


@final
class Bars:
    """A progress bar for each run; ``with Bars() as bars: bars.of("ur10_fast", 200.0)``.

    Parameters
    ----------
    quiet
        Show nothing; the default if standard error is not displayed.
    transient
        Remove the bars at the end.
    """

    def __init__(self, *, quiet: bool | None = None, transient: bool = False) -> None:
        self._bars: Any = None
        if quiet or (quiet is None and not sys.stderr.isatty()):
            return
        self._bars = _progress("s", transient=transient)

    def __enter__(self) -> Bars:
        if self._bars is not None:
            self._bars.start()
        return self

    def __exit__(self, *_: Any) -> None:
        if self._bars is not None:
            self._bars.stop()

    def of(self, name: str, total: float) -> Bar:
        """A new bar for a run of `total` seconds; returns a function to call with the simulated time."""
        if self._bars is None:
            return lambda _: None
        task = self._bars.add_task(name, total=total, speed="", note="")

        def done(time: float) -> None:
            elapsed = self._bars.tasks[task].elapsed
            self._bars.update(task, completed=time, speed=f"{time / elapsed:.0f} x real time" if elapsed else "")

        return done


@contextmanager
def shown(progress: bool | Bar | None, name: str, total: float) -> Iterator[Bar | None]:
    """The bar for the argument `progress` of `Graph.run`: a given one, none, or a new one."""
    if callable(progress):
        yield progress
    elif progress is False or (progress is None and not sys.stderr.isatty()):
        yield None
    else:
        with Bars(quiet=False, transient=True) as bars:
            yield bars.of(name, total)


@contextmanager
def progress_line(name: str, *, quiet: bool = False, kept: bool = False) -> Iterator[Callable[[str], None]]:
    """Show the current step in one transient line; nothing if standard error is not displayed.

    With `kept`, where standard error is not displayed, the first step and then one each `OFTEN` seconds at most are
    written as lines, so that the log of a long run shows that it advances.

    It starts no thread, since a process with threads cannot be forked (`dmframe.common.copies`). It does not import
    rich.
    """
    if quiet or not sys.stderr.isatty():
        yield _lines(name) if kept and not quiet else lambda _: None
        return
    width = shutil.get_terminal_size().columns - 1
    shown = ""

    def show(text: str) -> None:
        nonlocal shown
        before, shown = shown, visible(text)[:width]
        sys.stderr.write(f"\r{shown:{len(before)}}")
        sys.stderr.flush()

    show(name)
    try:
        yield lambda text: show(f"{name}: {text}")
    finally:
        show("")
        sys.stderr.write("\r")
        sys.stderr.flush()


def _lines(name: str) -> Callable[[str], None]:
    """Write a step as a line if the last one is `OFTEN` seconds old."""
    last = -math.inf

    def write(text: str) -> None:
        nonlocal last
        if time.monotonic() - last >= OFTEN:
            last = time.monotonic()
            sys.stderr.write(f"{visible(f'{name}: {text}')}\n")
            sys.stderr.flush()

    return write


@contextmanager
def counting(name: str, total: int, noun: str, *, quiet: bool | None = None) -> Iterator[Callable[[int, str], None]]:
    """A progress bar of counted items, with their rate and the remaining time.

    It yields a function to call with the number of finished items and a note. `quiet` is that of `Bars`.
    """
    bars = _progress(noun, disable=not sys.stderr.isatty() if quiet is None else quiet, speed_estimate_period=60)
    began: tuple[float, int] | None = None
    task = bars.add_task(name, total=total, start=False, speed="", note="")

    def done(count: int, note: str) -> None:
        nonlocal began
        if began is None:  # items finished before do not count for the rate
            began = (time.monotonic(), count)
            bars.update(task, completed=count)
            bars.start_task(task)
        elapsed, more = time.monotonic() - began[0], count - began[1]
        speed = f"{more / elapsed:.3g} {noun}/s" if more and elapsed > 0 else ""
        bars.update(task, completed=count, speed=speed, note=note)

    with bars:
        yield done
