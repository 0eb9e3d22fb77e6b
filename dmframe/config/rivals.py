"""Documents of controllers to compare with: some blocks of a graph replaced, others removed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from dmframe.config.document import Document, Node

Entries = Mapping[str, tuple[Node, Node]]
"""Keys and values of a mapping in a document."""


def replaced_blocks(data: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Dotted places and contents of the sections of a file that replace some of its blocks."""
    yield "baseline", data.get("baseline")
    page = data.get("page")
    rivals = page.get("rivals") if isinstance(page, dict) else None
    for name, rival in rivals.items() if isinstance(rivals, dict) else ():
        if isinstance(rival, dict) and "blocks" in rival:
            yield f"page.rivals.{name}.blocks", rival["blocks"]


def with_blocks(document: Document, section: Entries, *, without: Sequence[str]) -> Document:
    """The document with the blocks of a section; null removes a block, with its wires.

    It loses the keys `without`.
    """
    root: Any = document.root.value
    sections = {key: node.value for key, (_, node) in root.items()}
    blocks = {**sections["blocks"], **section}
    kept = {name: pair for name, pair in blocks.items() if pair[1].value is not None}
    gone = blocks.keys() - kept.keys()
    wires = {
        end: pair
        for end, pair in (sections.get("wires") or {}).items()
        if not {end.partition(".")[0], pair[1].value.partition(".")[0]} & gone
    }
    others = {"blocks": kept, "wires": wires}
    entries = {
        key: (word, replace(node, value=others[key]) if key in others else node)
        for key, (word, node) in root.items()
        if key not in without
    }
    return document.with_root(replace(document.root, value=entries))
