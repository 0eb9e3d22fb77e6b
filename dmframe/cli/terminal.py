"""Coloured text for a terminal."""

from __future__ import annotations

from rich.console import Console


def console(*, aside: bool = False, width: int | None = None) -> Console:
    """A console that prints a text as it is: names and messages of others may hold what rich would obey or hide.

    Where rich takes a text without its console (`TextColumn`, `Status`), it must be told once more.
    """
    return Console(stderr=aside, width=width, markup=False, emoji=False, highlight=False)
