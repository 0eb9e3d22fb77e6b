"""Writing a report: its kind by the name's ending, all of it or nothing."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from dmframe.catalogue import graphs as packaged
from dmframe.certify import Verdict
from dmframe.config import Graph
from dmframe.diagram import Diagram
from dmframe.errors import OutputError
from dmframe.files import check_place as check_file
from dmframe.files import write_text
from dmframe.report.content import Content, gather
from dmframe.report.data import as_data
from dmframe.report.page import as_html, as_markdown

Item = tuple[Graph, Diagram, Verdict]


def _as_json(contents: Sequence[Content]) -> str:
    return json.dumps(as_data(contents), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


WRITERS: Final[dict[str, Callable[[Sequence[Content]], str]]] = {
    ".html": as_html,
    ".md": as_markdown,
    ".json": _as_json,
}


def write_report(path: str | Path, items: Sequence[Item], *, overrides: Sequence[str] = (), seed: int = 0) -> None:
    """Write one report on one or several graphs: a web page, Markdown or JSON, by the ending of `path`.

    Each graph is simulated as its file says, to show V along the run. The file is there in full or not at all.

    Parameters
    ----------
    path
        ``.html`` (one file that opens offline and prints), ``.md`` or ``.json``.
    items
        Graphs with their diagrams and verdicts.
    overrides, seed
        As they were given to ``dmframe verify``, for the command that replays it.

    Raises
    ------
    OutputError
        Another ending, or a file that cannot be written.
    """
    path = Path(path)
    check_place(path)
    command = _command([graph for graph, _, _ in items], overrides, seed, path)
    contents = [gather(graph, diagram, verdict, command=command, seed=seed) for graph, diagram, verdict in items]
    write_text(path, WRITERS[path.suffix.lower()](contents))


def check_place(path: Path) -> None:
    """Can a report be written there? To be asked before anything is computed.

    Raises
    ------
    OutputError
        Another ending than those of `WRITERS`, a folder of that name, or no folder to write in.
    """
    if path.suffix.lower() not in WRITERS:
        endings = ", ".join(WRITERS)
        raise OutputError(f"{path}: expected a name that ends in {endings}, found {path.suffix or 'no ending'}")
    check_file(path)


def _command(graphs: Sequence[Graph], overrides: Sequence[str], seed: int, path: Path) -> list[str]:
    known = packaged()
    names = [
        graph.name if graph.name in known and str(known[graph.name]) == graph.document.name else graph.document.name
        for graph in graphs
    ]
    changes = [word for text in overrides for word in ("--set", text)]
    return ["dmframe", "verify", *names, *changes, "--seed", str(seed), "--report", path.name]
