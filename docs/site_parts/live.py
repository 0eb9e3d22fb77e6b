"""Live pages of the site: a file for each graph with its settings, and the HTML that embeds it in a page."""

from __future__ import annotations

import hashlib
import os
import shlex
import shutil
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Final

import dmframe as dm
from dmframe.graph.graph import Graph

FOLDER: Final = "live"
"""Folder of the live pages, in the root of the site."""
HEIGHT: Final = 860
"""Height of an embedded page [pixels]; a reader may open it separately."""


def graph_of(source: str | Path, settings: str = "") -> Graph:
    """A graph, by name or file, with settings as a command line has them, ``dynamics.Gamma=20 clock='2 ms'``."""
    from dmframe.graph.graph import Graph

    return Graph.read(source, shlex.split(settings)) if settings else dm.load(source)


def file_of(graph: Graph, settings: str = "") -> str:
    """The file's place in the site, ``live/ur10_fast.html``: one for each graph with its settings."""
    mark = hashlib.sha256(graph.text.encode()).hexdigest()[:8]
    return f"{FOLDER}/{graph.name}-{mark}.html" if settings else f"{FOLDER}/{graph.name}.html"


def write(graph: Graph, path: Path) -> Path:
    """Write the live page of a graph; several may do so at once."""
    path.parent.mkdir(parents=True, exist_ok=True)
    held = path.with_name(f".{os.getpid()}-{path.name}")
    held.write_text(graph.page().html, encoding="utf-8")
    held.replace(path)
    return path


def still(picture: Path, site: Path) -> str:
    """Copy a picture into the site; returns its place there, ``_images/ur10_fast.png``."""
    place = f"_images/{picture.name}"
    site.joinpath(place).parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(picture, site / place)
    return place


def embedded(
    address: str, title: str, height: int = HEIGHT, *, still: str = "", wide: bool = False, command: Sequence[str] = ()
) -> str:
    """The HTML that shows a live page within another: it is loaded when a reader scrolls near it.

    Parameters
    ----------
    address
        Of the live page, from the page that shows it.
    still
        Address of a picture that is seen until then.
    wide
        Wider than the text around it.
    command
        Command that writes the same page on a reader's machine.
    """
    behind = f' style="background-image:url({escape(still)})"' if still else ""
    alternative = f" or by <code>{escape(shlex.join(command))}</code>" if command else ""
    return (
        f'<figure class="live{" wide" * wide}"><div class="live-frame"{behind}>'
        f'<iframe loading="lazy" title="{escape(title)}" src="{escape(address)}" '
        f'height="{height}"></iframe></div>'
        f'<figcaption>{escape(title)}. <a href="{escape(address)}" target="_blank">Open it alone</a>{alternative}.'
        "</figcaption></figure>"
    )


def missing(name: str, why: str) -> str:
    """Replacement of a live page that cannot be made."""
    return f'<p class="live-missing">The live page of <code>{escape(name)}</code> is not here: {escape(why)}</p>'
