"""Dynamic modularity for robots whose joint servo is closed.

A controller is a graph of typed blocks in a short YAML file. A block states its equations once, together with its
storage function; from that single statement come the simulation, the C code and the exact certificate of stability.
The framework knows no block and no robot by name: they come from packages that register themselves under the
entry-point groups ``dmframe.blocks`` and ``dmframe.robots``.
"""

from __future__ import annotations

__all__ = ["__version__"]


def __getattr__(name: str) -> str:
    """Read the version when someone asks for it: `importlib.metadata` is slow to import."""
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import version

    return version("dmframe")
