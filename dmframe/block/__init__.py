"""Public interface for block authors: base classes, ports, parameters, certificate terms, names and operations.

.. code-block:: python

    from dmframe.block import AbstractBlock, Equations, Input, Output, Positive, Scalar, State
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dmframe.block.author import *  # noqa: F403 - `author.__all__` names them; the type checker follows it


def __getattr__(name: str) -> Any:
    if not (name == "__all__" or (name[0] != "_" and name in _author().__all__)):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(_author(), name)


def __dir__() -> list[str]:
    return list(_author().__all__)


def _author() -> Any:
    """The module with the names, imported by its path: `from dmframe.block import author` would call `__getattr__`."""
    return import_module("dmframe.block.author")
