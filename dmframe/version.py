"""Version of dmframe."""

from __future__ import annotations


def version() -> str:
    """Installed version, looked up at the call, since that takes a while."""
    from importlib.metadata import version as installed

    return installed("dmframe")
