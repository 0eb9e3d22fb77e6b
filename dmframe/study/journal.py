"""Journal of a study's folder: ``study.lock.json`` with its identity, and ``chunks.jsonl``, a line per chunk."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any, Final, final

from dmframe.common.errors import OutputError
from dmframe.common.files import append, is_hidden, put
from dmframe.common.units import shorten
from dmframe.study.chunks import Extent
from dmframe.study.executor import versions

LOCK: Final = "study.lock.json"
CHUNKS: Final = "chunks.jsonl"
_SHOWN: Final = 4
"""Differences that a message lists."""


@final
@dataclass(frozen=True)
class ChunkEntry:
    """A chunk that was written: one line of ``chunks.jsonl``."""

    file: str
    sha256: str
    rows: int
    seconds: float
    made: Mapping[str, str]


def entries_in(folder: Path) -> dict[str, ChunkEntry]:
    """Last line of each file; an incomplete line was left by a process that was ended."""
    found = dict[str, ChunkEntry]()
    try:
        text = (folder / CHUNKS).read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return found
    for line in text.splitlines():
        try:
            kept = ChunkEntry(**json.loads(line))
        except (ValueError, TypeError):
            continue
        found[kept.file] = kept
    return found


def end_line(path: Path) -> None:
    """End an incomplete line, so that the next one starts a new line."""
    with suppress(FileNotFoundError):
        with path.open("rb") as file:
            whole = file.read()[-1:] in (b"", b"\n")
        if not whole:
            append(path, "\n")


def is_partial(name: str) -> bool:
    """True for a temporary file of a process that was ended; earlier versions used the ending ``.tmp``."""
    return is_hidden(name) or name.endswith(".tmp")


def put_below(folder: Path, name: str, content: bytes) -> None:
    """Write a file in a folder that may not exist yet, unless it has that content already."""
    target = folder / name
    target.parent.mkdir(parents=True, exist_ok=True)
    if not target.is_file() or target.read_bytes() != content:
        put(target, content)


def read_lock(path: Path) -> dict[str, Any] | None:
    """The content of ``study.lock.json``; None if there is none. Raises `OutputError` if it is not valid."""
    try:
        lock = json.loads((path / LOCK).read_text(encoding="utf-8"))
        if not {"key", "versions", "identity", "samples", "extents", "each", "types"} <= lock.keys():
            raise ValueError
        _checked(lock)
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError, AttributeError):
        raise OutputError(
            f"{path / LOCK}: expected the record of a study, found something else; name another folder"
        ) from None
    return dict(lock)


def study_name_in(path: Path) -> str:
    """Name of the study in a folder; empty if there is none."""
    try:
        name = json.loads((path / LOCK).read_text(encoding="utf-8"))["study"]
    except (OSError, ValueError, KeyError, TypeError):
        return ""
    return name if isinstance(name, str) else ""


def _checked(lock: Mapping[str, Any]) -> None:
    """Raise `ValueError` or `TypeError` if a part has the wrong type."""
    extents, each = ([Extent(*numbers) for numbers in lock["extents"]], lock["each"] or ())
    numbers = [lock["samples"], *each, *(number for extent in extents for number in astuple(extent))]
    sizes = [*each, *(size for extent in extents for size in (extent.points, extent.samples))]
    whole = all(type(number) is int for number in numbers) and all(size > 0 for size in sizes) and len(each) in (0, 2)
    sections = [lock["identity"], lock["versions"], {} if lock["types"] is None else lock["types"]]
    if not whole or not all(isinstance(section, dict) for section in sections):
        raise ValueError


def difference(lock: Mapping[str, Any], identity: Mapping[str, Any]) -> str:
    """Changes since a study was started, in one sentence; empty if there are none."""
    old = _items(lock["identity"]) | _items(lock["versions"], "versions.")
    now = _items(plain(identity)) | _items(dict(versions()), "versions.")
    changed = [name for name in {**old, **now} if old.get(name) != now.get(name)]
    shown = [f"{name} was {_shown(old, name)}, now {_shown(now, name)}" for name in changed[:_SHOWN]]
    more = f"; and {len(changed) - _SHOWN} more" if len(changed) > _SHOWN else ""
    return f"holds another study: {'; '.join(shown)}{more}" if changed else ""


def plain(data: Any) -> Any:
    """Data as JSON returns it."""
    return json.loads(json.dumps(data, default=str))


def _items(data: Any, path: str = "") -> dict[str, str]:
    """Each number and text in nested data, by its path."""
    if not isinstance(data, dict):
        return {path.strip("."): json.dumps(data)}
    return {name: leaf for key, value in data.items() for name, leaf in _items(value, f"{path}{key}.").items()}


def _shown(items: Mapping[str, str], name: str) -> str:
    return shorten(items[name]) if name in items else "nothing"
