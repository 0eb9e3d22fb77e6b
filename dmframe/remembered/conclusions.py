"""Cache of what ``dmframe run`` concludes from its graphs only; valid while all inputs are unchanged.

A run computes and prints again everything that depends on its samples. The rest, such as the stability near the
set-point or the conditions under which there is a V, is decided once; a graph, a block or a library that has changed
since is decided again.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from dmframe.remembered import recorder, store

_recalled: list[dict[str, Any]] = []


def recall(entry: dict[str, Any]) -> None:
    """Read the cached conclusions for the call of this process."""
    _recalled[:] = entry["conclusions"]


def recalled(count: int) -> Sequence[dict[str, Any]]:
    """Cached conclusions, one for each of `count` graphs; empty without an entry."""
    return _recalled if len(_recalled) == count else ()


def keep(watching: recorder.Recorder | None, conclusions: Sequence[dict[str, Any]]) -> bool:
    """Store the conclusions of the call that `watching` recorded; returns True if they were stored."""
    entry = watching.entry() if watching is not None else None
    if watching is None or entry is None:
        return False
    return store.keep(watching.place, watching.call.key, {**entry, "conclusions": list(conclusions)})


__all__ = ["keep", "recall", "recalled"]
