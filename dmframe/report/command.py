"""Command line that reproduces an operation on a graph with its overrides."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import NamedTuple

from dmframe.catalogue import graphs
from dmframe.common.files import is_file
from dmframe.config import BaseGraph

ENDINGS = (".yaml", ".yml")


class Command(NamedTuple):
    """Shell command, and the text of a file that must be written before it (empty: none).

    ``--set`` addresses the blocks in `swapped` as ``baseline.block.parameter``.
    """

    text: str
    before: str
    swapped: tuple[str, ...] = ()


def command(graph: BaseGraph, verb: str) -> Command:
    """``dmframe VERB GRAPH --set ...``, quoted; a graph without a file has to be written to one first.

    A baseline has to be written to a file too, except for ``run``, which has the option ``--baseline``.
    """
    own, path, known = graph.name, graph.document.name, graphs()
    packaged = [name for name, place in known.items() if str(place) == path]
    file = Path(path).suffix.lower() in ENDINGS or is_file(Path(path))
    swapped = graph.swapped
    if (packaged or file) and (swapped is None or verb == "run"):
        changes = [word for text in graph.overrides for word in ("--set", text)]
        words = ["dmframe", verb, *(packaged[:1] or [path]), *["--baseline"] * (swapped is not None), *changes]
        return Command(shlex.join(words), "", swapped or ())
    return Command(shlex.join(["dmframe", verb, f"{own}.yaml"]), f"the graph's text in {own}.yaml")
