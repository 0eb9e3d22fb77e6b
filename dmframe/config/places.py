"""Places of faults: in the graph's file, or in an override."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Sequence
from typing import Any, Final

from dmframe.catalogue import block_types
from dmframe.common.errors import DmframeError, Faults, MissingError, UnknownNameError, WiringError, visible
from dmframe.config.document import Document
from dmframe.config.grammar import KEYS
from dmframe.diagram.wiring import ADD

TIMES: Final = (("duration",), ("solver", "output"), ("solver", "step"), ("log", "every"), ("clock",))
"""Keys that together determine the amount of computation: a fault in one may be caused by an override of another."""


def report(notices: Iterable[str]) -> None:
    """Print notices on stderr."""
    for notice in notices:
        sys.stderr.write(f"{visible(notice)}\n")


def placed(error: DmframeError, document: Document, keys: Sequence[str] = KEYS) -> DmframeError:
    """The fault, or several in the order of the file, with ``file:line:column``; `keys` are the keys of the file.

    A fault in a value set by an override is placed there, ``--set task.gamma=-1``; a fault of a whole block or section
    names the overrides that changed it.
    """
    faults = error.faults
    for fault in faults:
        if isinstance(fault, WiringError) and fault.missing and not fault.location:
            fault.text = _with_types(fault.text, fault.missing)
        fault.location = fault.location or _location(fault, document, keys)
    return Faults(sorted(faults, key=_place)) if isinstance(error, Faults) else error


def _with_types(text: str, port: str) -> str:
    """The message about a missing signal, with the block types that have it; without any, other remedies remain."""
    found = [name for name, kind in block_types().items() if any(output.name == port for output in kind.outputs)]
    if found:
        return f"{text}: {', '.join(found)}"
    others = text.removesuffix(f", or {ADD}")
    return others if others != text else f"{text}, of your own: no packaged type has one"


def _location(fault: DmframeError, document: Document, keys: Sequence[str]) -> str:
    """Place of the faulty value; for an unknown name, that of the key, value or list item.

    Empty for a fault that is not in a graph, such as one of an engine.
    """
    path = fault.path
    if path and path[0] not in (*keys, *document.data):
        return ""
    if path in TIMES:
        path = next((other for other in (path, *TIMES) if document.is_override(other)), path)
    if isinstance(fault, UnknownNameError):
        held: Any = document.data
        for part in path:
            held = held.get(part) if isinstance(held, dict) else None
        if isinstance(held, dict) and fault.name in held:
            path = (*path, fault.name)
        elif isinstance(held, list) and fault.name in held:
            path = (*path, held.index(fault.name))
    key = isinstance(fault, UnknownNameError) and path[-1:] == (fault.name,)
    place = document.locate(path, key=key)
    if document.is_override(path, key) or (isinstance(fault, MissingError) and len(path) == 1):
        return place
    changed = document.origins_below(path)
    return f"{place} with {', '.join(changed)}" if changed else place


def _place(fault: DmframeError) -> tuple[int, ...]:
    """Line and column of a fault's location; overrides come first."""
    return tuple(int(number) for number in re.findall(r":(\d+)(?=:\d+$|$)", fault.location.partition(" with --")[0]))
