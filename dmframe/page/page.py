"""Self-contained HTML file of a live page, usable without a network."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, final

from dmframe.block.model import SYMBOLIC
from dmframe.certify import Verdict
from dmframe.common import notebook
from dmframe.common.errors import OutputError
from dmframe.common.files import check_place, expanded, is_file, write_text, writing
from dmframe.config import BaseGraph
from dmframe.config.about import AboutGraph
from dmframe.page.content import content_of
from dmframe.page.periods import Periods, stable_periods
from dmframe.page.proof import Proof, proof_of
from dmframe.page.rivals import Rival

SCRIPTS: Final = ("solver.js", "verdict.js", "rivals.js", "plot.js", "scene.js", "sliders.js", "proof.js", "page.js")
"""Scripts in the order of the page."""
NO_PROOF: Final = Proof()
ENDINGS: Final = (".html", ".htm")
MARK: Final = b'<script type="application/json" id="data">'
"""Marker of a live page."""
HEIGHT: Final = 860
"""Height of the page in a notebook [px]."""


@final
@dataclass(frozen=True, repr=False, eq=False)
class Page(AboutGraph):
    """Live page: the closed loop simulated in a browser or notebook, with sliders and its verdict.

    Parameters
    ----------
    graph
        The simulated graph.
    verdict
        Its verdict; the page re-evaluates the conditions at the slider values.
    periods
        Largest stable sampling periods near the set-point; None if not computed.
    rivals
        Controllers simulated next to the graph's own; None for those of the graph.
    """

    graph: BaseGraph
    verdict: Verdict
    periods: Periods | None = None
    rivals: tuple[Rival, ...] | None = None

    @cached_property
    def html(self) -> str:
        """HTML of the page."""
        content = content_of(self.graph, self.verdict, self.periods, self.rivals)
        # a page that compares controllers, which the package contains, stays small without a certificate
        return assembled(content, NO_PROOF if content["rivals"] else proof_of(self.graph, self.verdict))

    def save(self, path: str | Path) -> Path:
        """Write the page; raises `OutputError` for an ending other than .html, or if it cannot be written."""
        path = expanded(path)
        check_page_place(path)
        write_text(path, self.html)
        return path

    def __repr__(self) -> str:
        return f"<Page of {self.graph.name}: {self.verdict.headline}>"

    def _repr_html_(self) -> str:
        return notebook.framed(self.html, f"live page of {self.graph.name}", HEIGHT)


def page_of(
    graph: BaseGraph, verdict: Verdict, rivals: tuple[Rival, ...] | None, *, periods: bool, tell: Callable[[str], None]
) -> Page:
    """The page of a proved graph, with its stable sampling periods if `periods`; `tell` reports what is computed."""
    found = None
    if periods:
        with SYMBOLIC:
            found = stable_periods(graph.diagram, graph.clock, verdict, graph.start, tell)
    tell("compiling the loop for a browser")
    page = Page(graph, verdict, found, rivals)
    _ = page.html
    return page


def check_page_place(path: Path) -> None:
    """Raise `OutputError` if no page can be written to `path`; call it before any computation."""
    if path.suffix.lower() not in ENDINGS:
        found = path.suffix or "none"
        raise OutputError(f"{path}: expected the ending {ENDINGS[0]}, found {found}; a live page is a web page")
    check_place(path)


def check_own_place(path: Path) -> None:
    """`check_page_place` for a default name: only an older live page may be replaced."""
    check_page_place(path)
    with writing(path):
        ours = not is_file(path) or MARK in path.read_bytes()
    if not ours:
        raise OutputError(f"{path}: expected no file or an older live page, found another file; name one with --out")


def assembled(content: dict[str, Any], proof: Proof = NO_PROOF) -> str:
    """HTML of a page from its data.

    The content security policy allows only the script and style of the page and the checker of its certificate, by
    their hashes, and no connection, so that user texts in a graph cannot run or load anything.
    """
    web = files("dmframe.page").joinpath("web")
    texts = {name: _bare(web.joinpath(name).read_text("utf-8")) for name in ("page.html", "page.css", *SCRIPTS)}
    look = files("dmframe.report").joinpath("look.css").read_text("utf-8")
    script, style = "\n".join(texts[name] for name in SCRIPTS), f"{_bare(look)}{texts['page.css']}"
    parts = {
        "TITLE": _escaped(content["title"] or content["name"]),
        "POLICY": policy(f"\n{script}\n", f"\n{style}\n", proof.script),
        "STYLE": style,
        # a text of a graph must not end the script element
        "DATA": json.dumps(content, ensure_ascii=False, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
        "SCRIPT": script,
        "CERTIFICATE": proof.certificate,
        "CHECKER": proof.checker,
    }
    return re.sub(f"@({'|'.join(parts)})@", lambda mark: parts[mark[1]], texts["page.html"])


def policy(script: str, style: str, checker: str = "") -> str:
    """Content security policy that allows only these scripts and this style (texts between their tags)."""
    scripts = " ".join(_hash(text) for text in (script, checker) if text)
    allowed = {
        "default-src": "'none'",
        "script-src": f"{scripts} 'wasm-unsafe-eval'",
        "style-src": _hash(style),
        "img-src": "data:",
        "connect-src": "'none'",
        "base-uri": "'none'",
        "form-action": "'none'",
    }
    return "; ".join(f"{name} {sources}" for name, sources in allowed.items())


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _bare(text: str) -> str:
    """Remove indentation and comment lines."""
    return re.sub(r"^[ \t]*(//.*)?\n?", "", text, flags=re.MULTILINE)


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
