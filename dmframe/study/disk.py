"""Files of a study's folder: on the disk in one step, or a line at a time."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

from dmframe.files import append, is_hidden, put

CHUNKS: Final = "chunks.jsonl"


@final
@dataclass(frozen=True)
class Kept:
    """What is known of a chunk that was written: one line of ``chunks.jsonl``."""

    file: str
    sha256: str
    rows: int
    seconds: float
    made: Mapping[str, str]


def kept_in(folder: Path) -> dict[str, Kept]:
    """By file, the last line of each; a line that is not whole is of a process that was ended."""
    found = dict[str, Kept]()
    try:
        text = (folder / CHUNKS).read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return found
    for line in text.splitlines():
        try:
            kept = Kept(**json.loads(line))
        except (ValueError, TypeError):
            continue
        found[kept.file] = kept
    return found


def end_line(path: Path) -> None:
    """End a line that was cut off: what is appended must begin one."""
    with suppress(FileNotFoundError):
        with path.open("rb") as file:
            whole = file.read()[-1:] in (b"", b"\n")
        if not whole:
            append(path, "\n")


def is_partial(name: str) -> bool:
    """True for the name of a file that a process left while it wrote; versions before had the ending ``.tmp``."""
    return is_hidden(name) or name.endswith(".tmp")


def put_below(folder: Path, name: str, content: bytes) -> None:
    """Write a file where it is not there already, in a folder that may be new."""
    target = folder / name
    target.parent.mkdir(parents=True, exist_ok=True)
    if not target.is_file() or target.read_bytes() != content:
        put(target, content)
