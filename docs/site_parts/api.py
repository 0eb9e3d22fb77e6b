"""Pages of the Python interface: the public names, what they return, and what a block's author imports."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple


class Chapter(NamedTuple):
    """A page of the interface.

    Parameters
    ----------
    modules, names
        What it documents: modules, and single names with their module.
    but
        Names of the modules that stand elsewhere.
    bases
        Whether it says what classes inherit.
    """

    title: str
    says: str
    modules: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    but: tuple[str, ...] = ()
    bases: bool = False


CHAPTERS: Final[Mapping[str, Chapter]] = {
    "dmframe": Chapter(
        "dmframe: load, run, prove",
        "The interface for programs and notebooks: ``import dmframe as dm``.",
        modules=("dmframe",),
        but=("DmframeError",),  # listed with the other errors
    ),
    "results": Chapter(
        "What the calls return",
        "Not constructed directly: the functions and methods of :mod:`dmframe` return them.",
        names=(
            "dmframe.report.Verification",
            "dmframe.report.Analysis",
            "dmframe.drawing.Drawing",
            "dmframe.page.Page",
            "dmframe.runtime.Controller",
            "dmframe.graph.named.Named",
        ),
    ),
    "errors": Chapter(
        "dmframe.errors: what is raised",
        "A user's mistake raises one of these, with *where: what was expected and found; the nearest right choice*.",
        modules=("dmframe.errors",),
        bases=True,
    ),
    "block": Chapter(
        "dmframe.block: what a block is",
        "The classes that a block inherits, and what its methods take and return.",
        modules=("dmframe.block",),
        bases=True,
    ),
    "port": Chapter("dmframe.port: ports and states", "What a block shows of itself.", modules=("dmframe.port",)),
    "parameter": Chapter(
        "dmframe.parameter: parameters",
        "How a block declares its gains, with sign, size and unit.",
        modules=("dmframe.parameter",),
    ),
    "certificate": Chapter(
        "dmframe.certificate: storage, dissipation, supply",
        "What a block states of its energy; see :doc:`../certificate`.",
        modules=("dmframe.certificate",),
    ),
    "linalg": Chapter(
        "dmframe.linalg: small matrices",
        "Linear algebra on expressions, in a form that the exact test can follow.",
        modules=("dmframe.linalg",),
    ),
    "naming": Chapter("dmframe.naming: names", "What names of blocks and signals may be.", modules=("dmframe.naming",)),
}
USERS: Final = ("dmframe", "results", "errors")


def pages() -> dict[str, str]:
    """The pages by their place in the site, in reStructuredText."""
    found = {f"reference/api/{name}.rst": _page(chapter) for name, chapter in CHAPTERS.items()}
    authors = [name for name in CHAPTERS if name not in USERS]
    lines = _title("Python interface")
    lines += ["Made from the types and docstrings of the code.", ""]
    for caption, names in (("To use it", USERS), ("To write blocks", authors)):
        lines += [
            ".. toctree::",
            f"   :caption: {caption}",
            "   :maxdepth: 1",
            "",
            *(f"   {name}" for name in names),
            "",
        ]
    return {"reference/api/index.rst": "\n".join(lines), **found}


def _title(text: str) -> list[str]:
    return [text, "=" * len(text), ""]


def _page(chapter: Chapter) -> str:
    lines = [*_title(chapter.title), chapter.says, ""]
    for module in chapter.modules:
        lines += [f".. automodule:: {module}", "   :members:", *["   :show-inheritance:"] * chapter.bases]
        lines += [f"   :exclude-members: {', '.join(chapter.but)}"] * bool(chapter.but) + [""]
    for name in chapter.names:
        lines += [f".. autoclass:: {name}", "   :members:", ""]
    return "\n".join(lines)
