"""``study.lock.json``: which study a folder holds, and how another one differs from it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import astuple
from pathlib import Path
from typing import Any, Final

from dmframe.errors import OutputError
from dmframe.study.chunks import Extent
from dmframe.study.computed import versions
from dmframe.units import shorten

LOCK: Final = "study.lock.json"
_TOLD: Final = 4
"""Differences that a message lists."""


def read_lock(path: Path) -> dict[str, Any] | None:
    """What ``study.lock.json`` says; None where there is none. Raises `OutputError` for one that cannot be read."""
    try:
        lock = json.loads((path / LOCK).read_text(encoding="utf-8"))
        if not {"key", "versions", "identity", "samples", "extents", "each", "types"} <= lock.keys():
            raise ValueError
        _checked(lock)
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError, AttributeError):
        raise OutputError(
            f"{path / LOCK}: expected what a study has written, found something else; name another folder"
        ) from None
    return dict(lock)


def begun_as(path: Path) -> str:
    """The name of the study that a folder holds; empty where it holds none."""
    try:
        name = json.loads((path / LOCK).read_text(encoding="utf-8"))["study"]
    except (OSError, ValueError, KeyError, TypeError):
        return ""
    return name if isinstance(name, str) else ""


def _checked(lock: Mapping[str, Any]) -> None:
    """Raise `ValueError` or `TypeError` where a part is no such part, whoever wrote it."""
    extents, each = ([Extent(*numbers) for numbers in lock["extents"]], lock["each"] or ())
    numbers = [lock["samples"], *each, *(number for extent in extents for number in astuple(extent))]
    sizes = [*each, *(size for extent in extents for size in (extent.points, extent.samples))]
    whole = all(type(number) is int for number in numbers) and all(size > 0 for size in sizes) and len(each) in (0, 2)
    sections = [lock["identity"], lock["versions"], {} if lock["types"] is None else lock["types"]]
    if not whole or not all(isinstance(section, dict) for section in sections):
        raise ValueError


def difference(lock: Mapping[str, Any], identity: Mapping[str, Any]) -> str:
    """In one sentence, what has changed since a study was begun; empty where nothing has."""
    old, now = ({**_leaves(held), **_leaves(of, "versions.")} for held, of in _both(lock, identity))
    changed = [name for name in {**old, **now} if old.get(name) != now.get(name)]
    told = [f"{name} was {_shown(old, name)}, now {_shown(now, name)}" for name in changed[:_TOLD]]
    more = f"; and {len(changed) - _TOLD} more" if len(changed) > _TOLD else ""
    return f"holds another study: {'; '.join(told)}{more}" if changed else ""


def _both(lock: Mapping[str, Any], identity: Mapping[str, Any]) -> Iterator[tuple[Any, Any]]:
    yield lock["identity"], lock["versions"]
    yield plain(identity), dict(versions())


def plain(data: Any) -> Any:
    """As it comes back from a file."""
    return json.loads(json.dumps(data, default=str))


def _leaves(data: Any, path: str = "") -> dict[str, str]:
    """Each number and text in nested data, by its path."""
    if not isinstance(data, dict):
        return {path.strip("."): json.dumps(data)}
    return {name: leaf for key, value in data.items() for name, leaf in _leaves(value, f"{path}{key}.").items()}


def _shown(leaves: Mapping[str, str], name: str) -> str:
    return shorten(leaves[name]) if name in leaves else "nothing"
