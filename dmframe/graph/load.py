"""Load a graph from a name, a path, a text or data."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dmframe.common.errors import ValueFault
from dmframe.config.document import read_document
from dmframe.config.given import document_of
from dmframe.graph.graph import Graph

TEXT = "graph"
"""Name in messages of a graph that is not from a file."""


def load(source: str | Path | Mapping[str, Any] | Graph, *, name: str = "", trust: bool = False) -> Graph:
    """A graph from its name, a path, a text or data.

    Parameters
    ----------
    source
        The name of a packaged graph, ``"ur10_fast"``; the path of a graph file; its text, of more than one line; a
        dictionary with the keys of the file; a `Graph` is returned unchanged.
    name
        Name of a graph from a text or a dictionary.
    trust
        Trust the blocks in the graph's folder from now on and execute their code, regardless of its author; see the
        notes.

    Raises
    ------
    DmframeError
        All faults of the graph at once, each with its line and column.

    Notes
    -----
    A block type ``my_file.py:MyBlock`` executes that file as a part of your program. A file that others may have
    written is executed in trusted folders only: one that belongs to another user, is writable by all, or was
    downloaded.
    """
    if trust:
        from dmframe.catalogue import find_graph
        from dmframe.common.trust import remember

        named = isinstance(source, Path) or (isinstance(source, str) and "\n" not in source)
        remember(find_graph(str(source)).parent if named else Path())
    if not isinstance(name, str):
        raise ValueFault(f"load: expected a text as name, found {name!r:.40}")
    if isinstance(source, Graph):
        return source
    if isinstance(source, Mapping):
        return Graph.of(document_of(source, name or TEXT))
    if isinstance(source, str) and "\n" in source:
        return Graph.of(read_document(source, name or TEXT))
    if not isinstance(source, str | Path):
        found = type(source).__name__
        raise ValueFault(f"load: expected a graph's name, its path, its text or a dictionary, found {found}")
    return Graph.read(source)
