"""Origin and licences of the robot model and meshes in a page."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from dmframe.config import BaseGraph
from dmframe.config.resolved import robot_source

SOURCE: Final = "SOURCE.md"
"""File of a packaged robot with its origin and licence in the first paragraphs."""
ABOVE: Final = 3
"""Number of parent folders of a URDF searched for a licence."""
MOST: Final = 20_000
"""Maximum length of a licence [characters]."""


def origin_of(graph: BaseGraph) -> dict[str, Any] | None:
    """Origin of the robot from its `SOURCE.md`, and its licences; None without a robot."""
    source = robot_source(graph)
    if source is None:
        return None
    stated = None if source.folder is None else source.folder / SOURCE
    text = _head(stated.read_text("utf-8")) if stated is not None and stated.is_file() else ""
    licences = dict(_licences(source.urdf))
    unknown = f"Origin and licence of {source.urdf.name} are unknown: no {SOURCE} and no licence file found."
    return {
        "robot": source.name,
        "text": text or ("" if licences else unknown),
        "licences": [{"name": name, "text": licence[:MOST]} for name, licence in licences.items()],
    }


def _head(text: str) -> str:
    """Text between title and first section, one line a paragraph."""
    body = re.sub(r"\A# .*\n", "", text).split("\n## ")[0]
    return "\n".join(" ".join(part.split()) for part in re.split(r"\n(?=[A-Z]\w+: )|\n\n", body.strip()))


def _licences(urdf: Path) -> Iterator[tuple[str, str]]:
    """Licence files and `package.xml` licences in the parent folders of a URDF, nearest first."""
    for folder in urdf.parents[:ABOVE]:
        for file in sorted(folder.glob("LICEN[CS]E*")) + sorted(folder.glob("COPYING*")):
            if file.is_file():
                yield f"{folder.name}/{file.name}", file.read_text("utf-8", errors="replace")
        manifest = folder / "package.xml"
        if manifest.is_file():
            stated = re.findall(r"<license[^>]*>(.*?)</license>", manifest.read_text("utf-8", errors="replace"))
            if stated:
                yield f"{folder.name}/package.xml", ", ".join(stated)
