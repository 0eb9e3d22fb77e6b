"""``dmframe studio``: edit a graph file in a browser, with diagram, verdict and live page."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Final

import typer

from dmframe.cli.arguments import Trust, graph_names
from dmframe.cli.streams import tell
from dmframe.common.errors import MissingError
from dmframe.common.version import installing

PACKAGES: Final = ("starlette", "uvicorn", "watchfiles")


def studio(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A graph file.", autocompletion=graph_names)],
    port: Annotated[int, typer.Option(metavar="N", help="Port on 127.0.0.1; 0 takes a free one.")] = 0,
    browser: Annotated[bool, typer.Option(help="Open the address in a browser.")] = True,
    trust: Trust = False,
) -> None:
    """Edit a graph file in a browser, with its diagram, verdict and live page, until Ctrl-C.

    The file changes only when you save. The server is reached from this computer only, with the token of its address.
    """
    missing = [name for name in PACKAGES if find_spec(name) is None]
    if missing:
        raise MissingError(f"studio: {', '.join(missing)} not installed; {installing('studio')}")
    from dmframe.studio.serve import graph_file, serve

    path: Path = graph_file(file)
    if trust:
        from dmframe.common.trust import remember

        remember(path.parent)
    serve(path, port, browser=browser, tell=tell)
