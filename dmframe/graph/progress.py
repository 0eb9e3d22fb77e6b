"""The bar of a long run, on standard error."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, final

from dmframe.simulate.march import Progress as Bar

if TYPE_CHECKING:  # where nobody sees standard error, rich is not imported
    from rich.console import Console

__all__ = ["Bar", "Bars", "counting", "progress_line", "shown"]


def _aside() -> Console:
    """Standard error, for texts as they are: names of others may hold what rich would obey or hide.

    Where rich takes a text without its console (`TextColumn`, a status), it must be told once more.
    """
    from rich.console import Console

    return Console(stderr=True, markup=False, emoji=False, highlight=False)


@final
class Bars:
    """A bar for each run; ``with Bars() as bars: bars.of("ur10_fast", 200.0)``.

    Parameters
    ----------
    quiet
        Show nothing; by default where nobody sees standard error.
    transient
        Take the bars away at the end.
    """

    def __init__(self, *, quiet: bool | None = None, transient: bool = False) -> None:
        self._bars: Any = None
        if quiet or (quiet is None and not sys.stderr.isatty()):
            return
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        self._bars = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=30),
            TextColumn("{task.completed:.0f} / {task.total:.0f} s"),
            TextColumn("{task.fields[speed]}"),
            TimeRemainingColumn(),
            console=_aside(),
            transient=transient,
        )

    def __enter__(self) -> Bars:
        if self._bars is not None:
            self._bars.start()
        return self

    def __exit__(self, *_: Any) -> None:
        if self._bars is not None:
            self._bars.stop()

    def of(self, name: str, total: float) -> Bar:
        """A new bar for a run of `total` seconds; what it returns is called with the simulated time."""
        if self._bars is None:
            return lambda _: None
        task = self._bars.add_task(name, total=total, speed="")

        def done(time: float) -> None:
            elapsed = self._bars.tasks[task].elapsed
            self._bars.update(task, completed=time, speed=f"{time / elapsed:.0f} x real time" if elapsed else "")

        return done


@contextmanager
def shown(progress: bool | Bar | None, name: str, total: float) -> Iterator[Bar | None]:
    """A bar as `Graph.run` is asked for: one that is given, none, or one of its own."""
    if callable(progress):
        yield progress
    elif progress is False or (progress is None and not sys.stderr.isatty()):
        yield None
    else:
        with Bars(quiet=False, transient=True) as bars:
            yield bars.of(name, total)


@contextmanager
def progress_line(name: str, *, quiet: bool = False) -> Iterator[Callable[[str], None]]:
    """Say what is done, in one line that comes and goes; where nobody sees standard error, nothing."""
    if quiet or not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.text import Text

    console = _aside()
    with console.status(Text(name)) as status:
        yield lambda text: status.update(Text(f"{name}: {text}"))


@contextmanager
def counting(name: str, total: int, noun: str, *, quiet: bool | None = None) -> Iterator[Callable[[int, str], None]]:
    """A bar of things that are counted, with how many a second and the time that is left.

    What it yields is called with how many are done, and a word beside the bar. `quiet` is as `Bars` has it.
    """
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    bars = Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=30),
        TextColumn(f"{{task.completed:.0f}} / {{task.total:.0f}} {noun}"),
        TextColumn("{task.fields[speed]}"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}", markup=False),
        console=_aside(),
        disable=not sys.stderr.isatty() if quiet is None else quiet,
        speed_estimate_period=60,
    )
    began: tuple[float, int] | None = None
    task = bars.add_task(name, total=total, start=False, speed="", note="")

    def done(count: int, note: str) -> None:
        nonlocal began
        if began is None:  # what was there before says nothing about speed
            began = (time.monotonic(), count)
            bars.update(task, completed=count)
            bars.start_task(task)
        elapsed, more = time.monotonic() - began[0], count - began[1]
        speed = f"{more / elapsed:.3g} {noun}/s" if more and elapsed > 0 else ""
        bars.update(task, completed=count, speed=speed, note=note)

    with bars:
        yield done
