"""What several commands take, and what a shell completes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def graph_names(begin: str) -> list[str]:
    """For a shell's completion: packaged graphs, and graph files."""
    from dmframe.catalogue import graphs as packaged

    folder = Path(begin).parent
    try:
        files = [str(path) for path in folder.iterdir() if path.suffix in (".yaml", ".yml")]
    except OSError:
        files = []
    return [name for name in (*files, *packaged()) if name.startswith(begin)]


def type_names(begin: str) -> list[str]:
    """For a shell's completion: types of blocks."""
    from dmframe.catalogue import block_modules

    return [name for name in block_modules() if name.startswith(begin)]


def robot_names(begin: str) -> list[str]:
    """For a shell's completion: packaged robots."""
    from dmframe.robot.library import robots as known

    return [name for name in known() if name.startswith(begin)]


Graphs = Annotated[
    list[str],
    typer.Argument(metavar="GRAPH...", help="Graph files, or names of packaged graphs.", autocompletion=graph_names),
]
OneGraph = Annotated[
    str,
    typer.Argument(metavar="GRAPH", help="A graph file, or the name of a packaged graph.", autocompletion=graph_names),
]
Overrides = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="BLOCK.PARAM=VALUE",
        help="Change a value; may be repeated. A.yaml:BLOCK.PARAM=VALUE: of that graph alone.",
    ),
]
Trust = Annotated[
    bool,
    typer.Option("--trust", help="Run the code of blocks in the graph's folder, though others may have written it."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object (a list for several graphs).")]
Listed = Annotated[bool, typer.Option("--json", help="Print a JSON list.")]
