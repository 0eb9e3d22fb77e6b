"""Which dmframe this is."""

from __future__ import annotations


def version() -> str:
    """The installed version; it is looked up when it is asked for, which takes a while."""
    from importlib.metadata import version as installed

    return installed("dmframe")
