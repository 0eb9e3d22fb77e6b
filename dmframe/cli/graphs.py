"""Graphs of a command with their overrides ``--set``.

``--set block.parameter=value`` applies to every graph, ``--set A.yaml:block.parameter=value`` to one graph, and
``--set block.parameter=1,10,100`` makes three variants of each.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from pathlib import Path

from dmframe.catalogue import find_graph
from dmframe.common.errors import DmframeError, UnknownNameError, ValueFault
from dmframe.common.trust import remember
from dmframe.graph.graph import Graph

_FREE = ("title",)
"""Keys whose text may contain commas."""
_NESTED = re.compile(r"""("(?:\\.|[^"])*"|'(?:''|[^'])*'|[\[\](){}]|,)""")


def graphs_of(names: Sequence[str], overrides: Sequence[str], *, trust: bool = False) -> list[Graph]:
    """Graphs of all names and combinations of swept values; raises the errors of `Graph.read`.

    With `trust`, the code of blocks in the folder of a graph is trusted from now on.
    """
    if trust:
        for path in map(find_graph, names):
            if path.is_file():
                remember(path.parent)
    mine = {place: list[str]() for place in range(len(names))}
    for text in overrides:
        places, rest = _addressed(text, names)
        for place in places:
            mine[place].append(rest)
    return [
        _loaded(name, chosen, alone=len(names) == 1)
        for place, name in enumerate(names)
        for chosen in itertools.product(*map(alternatives, mine[place]))
    ]


def one_graph(name: str, overrides: Sequence[str], *, trust: bool = False) -> Graph:
    """Graph of a command that takes one graph."""
    found = graphs_of([name], overrides, trust=trust)
    if len(found) > 1:
        raise ValueFault(f"--set: several values make {len(found)} graphs, expected one; `dmframe run` takes several")
    return found[0]


def _addressed(text: str, names: Sequence[str]) -> tuple[list[int], str]:
    """Indices of the graphs of an override, and the override without the graph name."""
    label, equals, value = text.partition("=")
    graph, colon, key = label.rpartition(":")
    if not colon:
        return list(range(len(names))), text
    places = [place for place, name in enumerate(names) if graph.strip() == name]
    if not places:
        places = [place for place, name in enumerate(names) if graph.strip() == Path(name).stem]
        if len({names[place] for place in places}) > 1:
            alike = " and ".join(dict.fromkeys(names[place] for place in places))
            raise ValueFault(f"--set {label}: {graph.strip()} may be {alike}; write the full name")
    if not places:
        raise UnknownNameError(f"--set {label}", "graph", graph.strip(), names)
    return places, f"{key}{equals}{value}"


def alternatives(text: str) -> list[str]:
    """Overrides for each of the comma-separated values: ``a.b=1,10`` is ``a.b=1`` and ``a.b=10``.

    Commas in brackets and quotes belong to one value.
    """
    label, _, value = text.partition("=")
    if label.strip() in _FREE:
        return [text]
    parts, depth = [""], 0
    for piece in _NESTED.split(value):
        if piece == "," and depth == 0:
            parts.append("")
            continue
        depth += (piece in "[({") - (piece in "])}") if len(piece) == 1 else 0
        parts[-1] += piece
    if len(parts) == 1:
        return [text]
    if not all(part.strip() for part in parts):
        raise ValueFault(f"--set {text}: expected a value between commas; put a text with commas in quotes")
    return [f"{label}={part.strip()}" for part in parts]


def _loaded(name: str, overrides: Sequence[str], *, alone: bool) -> Graph:
    try:
        return Graph.read(name, overrides)
    except DmframeError as error:
        for fault in error.faults:
            if not alone and not fault.location and name not in fault.text:
                fault.location = name  # which of the graphs
        raise
