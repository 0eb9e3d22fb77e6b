"""Classes of a user's block file from a second execution of the file.

A file that reads a clock or random numbers where it is loaded states another model in each process: `verify` would
prove one, and `run` would simulate another.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, Final, TypeVar
from weakref import WeakKeyDictionary

from dmframe.block.faults import fault_context
from dmframe.block.numberless import given_values
from dmframe.common.errors import BlockError

if TYPE_CHECKING:
    from dmframe.block.base import AbstractBlock

B = TypeVar("B", bound="AbstractBlock")

CODE: Final = "__dmframe_code__"
"""Name, in the module of a user's file, of the file's compiled code."""

STEADY: Final = "expected the same each time, without a clock and without random numbers"

_AGAIN: WeakKeyDictionary[type[Any], type[Any]] = WeakKeyDictionary()


def made_again(name: str, block: B) -> B | None:
    """The block as its class from a second execution makes it; None for a class that is of no user's file.

    Raises `BlockError` for a file that cannot be executed twice, or with other defaults.
    """
    kind = type(block)
    module = vars(sys.modules.get(kind.__module__, sys))
    names = [key for key, value in module.items() if value is kind] if CODE in module else []
    if not names:
        return None
    if kind not in _AGAIN:
        space = {key: module[key] for key in ("__name__", "__file__", "__spec__", "__loader__", "__package__", CODE)}
        with fault_context(name, "its file when loaded again"):
            exec(module[CODE], space)
            _AGAIN[kind] = space[names[0]]
    other = _AGAIN[kind]
    for field, declared in kind.model_fields.items():
        if field not in other.model_fields or repr(other.model_fields[field].default) != repr(declared.default):
            raise BlockError(f"{name}: its file declares another {field} when loaded again; {STEADY}")
    made: B = other(**given_values(block))
    return made
