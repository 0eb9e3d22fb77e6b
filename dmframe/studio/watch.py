"""Changes of a file by other programs."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Final

from watchfiles import awatch

READ: Final = (".py", ".urdf", ".xacro", ".xml", ".csv", ".yaml", ".yml", ".json")
"""Files next to a graph that may change what it means."""
DELAY: Final = 100
"""Time over which changes are collected [ms]."""
FORCED: Final = 2000
"""Interval at which the watcher returns without a change, to look at `ending` [ms]."""


async def changes(path: Path, ending: asyncio.Event) -> AsyncIterator[bool]:
    """True at each change of the file, False at each change of other files in its folder that a graph may read.

    The folder is watched and not the file, which many programs replace. A link is followed.
    """
    real = path.resolve()
    while not ending.is_set():
        try:
            async for found in awatch(
                real.parent,
                watch_filter=lambda _, name: Path(name).suffix in READ or Path(name) == real,
                debounce=DELAY,
                step=DELAY // 2,
                rust_timeout=FORCED,
                yield_on_timeout=False,
                recursive=False,
                stop_event=ending,
            ):
                names = {Path(name) for _, name in found}
                if real in names:
                    yield True
                if names - {real}:
                    yield False
        except (FileNotFoundError, OSError):  # the folder is gone
            await asyncio.sleep(1)
