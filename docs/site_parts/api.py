"""Pages of the Python interface: the public names, their results, and the names for authors of blocks."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Final, NamedTuple


class Chapter(NamedTuple):
    """A page of the interface.

    Parameters
    ----------
    modules, names
        Documented modules, and single names with their module.
    but, shared
        Names that another page documents, and modules with public names on another page.
    bases
        Whether base classes are shown.
    """

    title: str
    text: str
    modules: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    but: tuple[str, ...] = ()
    shared: tuple[str, ...] = ()
    bases: bool = False


CHAPTERS: Final[Mapping[str, Chapter]] = {
    "dmframe": Chapter(
        "dmframe: load, run, prove",
        "The interface for programs and notebooks: ``import dmframe as dm``.",
        modules=("dmframe",),
        but=("DmframeError",),  # listed with the other errors
    ),
    "results": Chapter(
        "Results of calls",
        "These classes are not constructed directly: the functions and methods of :mod:`dmframe` return them.",
        names=(
            "dmframe.report.verification.Verification",
            "dmframe.report.analysis.Analysis",
            "dmframe.drawing.Drawing",
            "dmframe.page.Page",
            "dmframe.runtime.Controller",
            "dmframe.config.registry.Registry",
        ),
    ),
    "errors": Chapter(
        "dmframe.common.errors: exceptions",
        "A user's mistake raises one of these, with *where: what was expected and found; the nearest right choice*.",
        modules=("dmframe.common.errors",),
        bases=True,
    ),
    "block": Chapter(
        "dmframe.block: blocks",
        "The base classes of blocks, and the arguments and results of their methods. ``from dmframe.block import ...`` "
        "provides the names of the following pages too.",
        modules=("dmframe.block",),
        shared=(
            "dmframe.block.port",
            "dmframe.block.parameter",
            "dmframe.block.certificate",
            "dmframe.block.linalg",
            "dmframe.block.naming",
        ),
        bases=True,
    ),
    "port": Chapter(
        "dmframe.block.port: ports and states",
        "The inputs, outputs and states of a block.",
        modules=("dmframe.block.port",),
    ),
    "parameter": Chapter(
        "dmframe.block.parameter: parameters",
        "Declarations of a block's gains, with sign, size and unit.",
        modules=("dmframe.block.parameter",),
    ),
    "certificate": Chapter(
        "dmframe.block.certificate: storage, dissipation, supply",
        "The storage function of a block and its rate; see :doc:`../certificate`.",
        modules=("dmframe.block.certificate",),
    ),
    "linalg": Chapter(
        "dmframe.block.linalg: small matrices",
        "Linear algebra on expressions, in a form that the exact test supports.",
        modules=("dmframe.block.linalg",),
    ),
    "naming": Chapter(
        "dmframe.block.naming: names", "Valid names of blocks and signals.", modules=("dmframe.block.naming",)
    ),
}
USERS: Final = ("dmframe", "results", "errors")


def pages() -> dict[str, str]:
    """The pages by their place in the site, in reStructuredText."""
    found = {f"reference/api/{name}.rst": _page(chapter) for name, chapter in CHAPTERS.items()}
    authors = [name for name in CHAPTERS if name not in USERS]
    lines = _title("Python interface")
    lines += ["Generated from the types and docstrings of the code.", ""]
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


def public(name: str) -> list[str]:
    """Names on the page of a module."""
    module = import_module(name)
    own = [key for key, value in vars(module).items() if getattr(value, "__module__", None) == name]
    return list(getattr(module, "__all__", [key for key in own if not key.startswith("_")]))


def _title(text: str) -> list[str]:
    return [text, "=" * len(text), ""]


def _page(chapter: Chapter) -> str:
    lines = [*_title(chapter.title), chapter.text, ""]
    but = [*chapter.but, *(name for module in chapter.shared for name in public(module))]
    for module in chapter.modules:
        lines += [f".. automodule:: {module}", "   :members:", *["   :show-inheritance:"] * chapter.bases]
        lines += [f"   :exclude-members: {', '.join(but)}"] * bool(but) + [""]
    for name in chapter.names:
        lines += [f".. autoclass:: {name}", "   :members:", ""]
    return "\n".join(lines)
