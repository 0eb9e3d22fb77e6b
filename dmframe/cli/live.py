"""``dmframe page`` and ``dmframe demo``: write a live page, or open one that was built before."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated, Final

import typer

from dmframe.cli.arguments import NOTHING, OneGraph, Overrides, Trust, home
from dmframe.cli.streams import tell
from dmframe.common.errors import MissingError
from dmframe.common.files import write_text

BASELINE: Final = "baseline"


def page(
    graph: OneGraph,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FILE", callback=home, help="A file .html; GRAPH.html without it."),
    ] = None,
    periods: Annotated[bool, typer.Option(help="Compute the largest stable sampling periods; takes seconds.")] = True,
    ghost: Annotated[
        str | None, typer.Option(metavar="GRAPH", help="Simulate this graph too, or the graph's baseline: baseline.")
    ] = None,
    overrides: Overrides = NOTHING,
    trust: Trust = False,
) -> None:
    """Write a live page of a graph: simulation in a browser, with sliders and the verdict."""
    from dmframe.cli.graphs import one_graph
    from dmframe.page.page import check_own_place, check_page_place
    from dmframe.results.folder import safe_name

    loaded = one_graph(graph, overrides, trust=trust)
    place = out if out is not None else Path(f"{safe_name(loaded.name)}.html")
    (check_page_place if out is not None else check_own_place)(place)
    other = None if ghost in (None, BASELINE) else one_graph(ghost, [], trust=trust)
    loaded.page(periods=periods, ghost=loaded.baseline() if ghost == BASELINE else other).save(place)
    tell(f"wrote {place}")


def demo(
    name: Annotated[str | None, typer.Argument(metavar="PAGE", help="A packaged page; the first without it.")] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="FILE", callback=home, help="Copy the page to this new file.")
    ] = None,
    no_open: Annotated[bool, typer.Option("--no-browser", "--no-open", help="Print the path only.")] = False,
) -> None:
    """Open a live page of the package in a browser: a controller next to its rivals.

    The page needs no network and no server. Its path is printed, for another browser.
    """
    from dmframe.catalogue import find_page, pages

    names = list(pages())
    if not names:
        raise MissingError("demo: expected a packaged page, found none; install dmframe again")
    page = find_page(name or names[0])
    if out is not None:
        from dmframe.page.page import check_page_place

        check_page_place(out)
        write_text(out, page.read_text("utf-8"), new=True)
        page = out
    tell(str(page))
    if not no_open and not webbrowser.open(page.resolve().as_uri()):
        tell("no browser was found; open this file in one", aside=True)
