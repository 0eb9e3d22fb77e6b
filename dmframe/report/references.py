"""Bibliography of the blocks, from ``references.bib`` of each block package."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from dmframe.catalogue import packages
from dmframe.common.errors import DmframeError

_ENTRY: Final = re.compile(r"^@\w+\{\s*([^,\s]+)\s*,(.*?)^\}", re.MULTILINE | re.DOTALL)
_FIELD: Final = re.compile(r"^\s*(\w+)\s*=\s*\{(.*)\},?\s*$", re.MULTILINE)
_WHERE: Final = ("journal", "booktitle", "publisher", "institution", "school", "howpublished")


def reference(key: str) -> str:
    """Formatted reference of a source; a hint for a key that is in no bibliography."""
    fields = _bibliography().get(key)
    return _formatted(fields) if fields else "see the documentation of the block that cites it"


@functools.cache
def _bibliography() -> dict[str, dict[str, str]]:
    """The fields of each source, by its key."""
    found = dict[str, dict[str, str]]()
    try:
        folders = [Path(folder) for package in packages() for folder in package.__path__]
    except DmframeError:  # reported by the catalogue
        return found
    for folder in folders:
        file = folder / "references.bib"
        if file.is_file():
            for entry in _ENTRY.finditer(file.read_text(encoding="utf-8")):
                found[entry[1]] = dict(_FIELD.findall(entry[2]))
    return found


def _formatted(fields: Mapping[str, str]) -> str:
    """``H. Wang, W. Ren, “Title”, Journal 65(6), 2020, pp. 1–8``."""
    authors = ", ".join(_forwards(name) for name in fields.get("author", "").split(" and ") if name)
    number = f"({fields['number']})" if "number" in fields else ""
    volume = f" {fields['volume']}{number}" if "volume" in fields else ""
    place = next((fields[kind] for kind in _WHERE if kind in fields), "")
    pages = f"pp. {fields['pages'].replace('--', '–')}" if "pages" in fields else ""
    title = f"“{fields.get('title', '')}”"
    parts = [authors, title, f"{place}{volume}".strip(), fields.get("year", ""), pages]
    return ", ".join(re.sub(r"[{}]", "", part) for part in parts if part) + "."


def _forwards(name: str) -> str:
    """``Wang, H.`` as ``H. Wang``."""
    last, _, first = name.strip().partition(", ")
    return f"{first} {last}".strip()
