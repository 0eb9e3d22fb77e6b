"""Export of a graph into a folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from dmframe.common.errors import OutputError, ValueFault
from dmframe.common.files import encoded, expanded
from dmframe.config import BaseGraph
from dmframe.export import TARGETS, Files, TargetFunction
from dmframe.results.place import Place, built, locked


def export(graph: BaseGraph, folder: str | Path, target: str | TargetFunction) -> list[Path]:
    """Write the files of a target into a folder; returns them.

    Parameters
    ----------
    target
        A name in `TARGETS`, or a function (graph) -> files by their paths below the folder.

    Raises
    ------
    DmframeError
        The target is unknown, returns no files, or does not support the graph; or the folder exists already.
    """
    if isinstance(target, str) and target in TARGETS:
        function, into_existing = TARGETS[target].function, TARGETS[target].into_existing
    elif callable(target):
        function, into_existing = target, False
    else:
        raise ValueFault(f"kind: expected {', '.join(TARGETS)}, or a function of the graph; found {target!r}")
    place = expanded(folder)
    if place.exists() and not into_existing:
        raise OutputError(f"{place}: exists already; choose a new folder")
    return write_all(place, _checked(function(graph)))


def _checked(contents: Any) -> Files:
    """What a target returned, if it is files with relative paths. Raises `ValueFault`."""
    if not isinstance(contents, Mapping) or not contents:
        raise ValueFault(f"export: expected the target to return files by name, found {contents!r:.60}")
    for name, content in contents.items():
        path = PurePosixPath(name) if isinstance(name, str) else None
        if path is None or path.is_absolute() or not path.parts or ".." in path.parts:
            raise ValueFault(f"export: expected the target to name files below the folder, found {name!r}")
        if not isinstance(content, str | bytes):
            raise ValueFault(f"export: expected {name} as str or bytes, found {type(content).__name__}")
    return contents


def write_all(place: Path, contents: Files) -> list[Path]:
    """Write files by their paths below a folder, all or none, with the folder locked. Raises `OutputError`.

    A new folder has its name only when all files are on the disk.
    """
    files = [place / name for name in contents]
    with locked(place) as (folder, _, made):
        if there := [file for file in files if file.exists()]:  # another export was first
            raise OutputError(f"{there[0]}: exists already; choose a new folder")
        target = Place(place, folder, folder in made)
        try:
            with built(target, seal=False) as building:
                for name, content in contents.items():
                    file = building / name
                    file.parent.mkdir(parents=True, exist_ok=True)
                    file.write_bytes(content if isinstance(content, bytes) else encoded(content))
        finally:
            target.release()
    return files
