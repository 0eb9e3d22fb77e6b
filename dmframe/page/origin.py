"""Where a page's robot comes from, and under which licence: a page carries its numbers and meshes with it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import Any, Final

from dmframe.config import Experiment
from dmframe.results.resolved import robot_source

SOURCE: Final = "SOURCE.md"
"""In the folder of a packaged robot: its first paragraphs state origin and licence."""
COLLECTION: Final = "example-robot-data"
"""The package whose models and meshes most packaged robots are."""
ABOVE: Final = 3
"""Folders above a URDF in which its licence may lie."""
MOST: Final = 20_000
"""Characters of one licence."""


def origin_of(experiment: Experiment) -> dict[str, Any] | None:
    """The origin of the robot as its `SOURCE.md` states it, and the licences that lie with it; None without a robot."""
    source = robot_source(experiment)
    if source is None:
        return None
    stated = None if source.folder is None else source.folder / SOURCE
    text = _head(stated.read_text("utf-8")) if stated is not None and stated.is_file() else ""
    licences = dict(_licences(source.urdf))
    if COLLECTION in source.urdf.parts:
        licences |= dict(_of_the_collection())
    unknown = f"No {SOURCE} and no licence lie with {source.urdf.name}: its origin and licence are not known here."
    return {
        "robot": source.name,
        "text": text or ("" if licences else unknown),
        "licences": [{"name": name, "text": licence[:MOST]} for name, licence in licences.items()],
    }


def _head(text: str) -> str:
    """What stands between the title and the first section, as one line a paragraph."""
    body = re.sub(r"\A# .*\n", "", text).split("\n## ")[0]
    return "\n".join(" ".join(part.split()) for part in re.split(r"\n(?=[A-Z]\w+: )|\n\n", body.strip()))


def _licences(urdf: Path) -> Iterator[tuple[str, str]]:
    """The licence files of the folders above a URDF, the nearest first, and what a `package.xml` there states."""
    for folder in urdf.parents[:ABOVE]:
        for file in sorted(folder.glob("LICEN[CS]E*")) + sorted(folder.glob("COPYING*")):
            if file.is_file():
                yield f"{folder.name}/{file.name}", file.read_text("utf-8", errors="replace")
        manifest = folder / "package.xml"
        if manifest.is_file():
            stated = re.findall(r"<license[^>]*>(.*?)</license>", manifest.read_text("utf-8", errors="replace"))
            if stated:
                yield f"{folder.name}/package.xml", ", ".join(stated)


def _of_the_collection() -> Iterator[tuple[str, str]]:
    """The licence of the installed collection."""
    try:
        found = files(COLLECTION) or []
    except PackageNotFoundError:
        return
    for file in found:
        if "LICENSE" in file.name and "licenses" in file.parts:
            yield f"{COLLECTION}/{file.name}", file.read_text()
