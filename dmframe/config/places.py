"""Where the culprit of a fault stands: in the graph's file, or in what was set on top of it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Final

from dmframe.catalogue import block_types
from dmframe.config.document import Document
from dmframe.config.grammar import KEYS
from dmframe.errors import DmframeError, Faults, MissingError, UnknownNameError, WiringError

TIMES: Final = (("duration",), ("solver", "output"), ("solver", "step"), ("log", "every"), ("clock",))
"""They say together how much a run computes: of a fault in one, another may be the cause that an override has set."""


def placed(error: DmframeError, document: Document, keys: Sequence[str] = KEYS) -> DmframeError:
    """The fault, or each of several in the order of the file, with ``file:line:column``; `keys` may stand in the file.

    One whose culprit an override has set is placed there, ``--set task.gamma=-1``; one of a whole block or section says
    which overrides changed it.
    """
    faults = error.faults
    for fault in faults:
        if isinstance(fault, WiringError) and fault.missing and not fault.location:
            fault.text += _that_have(fault.missing)
        fault.location = fault.location or _location(fault, document, keys)
    return Faults(sorted(faults, key=_place)) if isinstance(error, Faults) else error


def _that_have(port: str) -> str:
    """Which types of blocks have such an output, to end a message that asks for one."""
    found = [name for name, kind in block_types().items() if any(output.name == port for output in kind.outputs)]
    return f": {', '.join(found)}" if found else ""


def _location(fault: DmframeError, document: Document, keys: Sequence[str]) -> str:
    """Where the culprit stands: an unknown name itself, be it a key, a value or an item of a list.

    Empty for what is said of no graph, such as an engine.
    """
    path = fault.path
    if path and path[0] not in (*keys, *document.data):
        return ""
    if path in TIMES:
        path = next((other for other in (path, *TIMES) if document.is_said(other)), path)
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
    if document.is_said(path, key) or (isinstance(fault, MissingError) and len(path) == 1):
        return place
    changed = document.said_below(path)
    return f"{place} with {', '.join(changed)}" if changed else place


def _place(fault: DmframeError) -> tuple[int, ...]:
    """Line and column of a fault's location; overrides come first."""
    return tuple(int(number) for number in re.findall(r":(\d+)(?=:\d+$|$)", fault.location.partition(" with --")[0]))
