"""One self-contained file from a page's data: nothing is fetched, so that it opens from a disk without a network."""

from __future__ import annotations

import json
import re
from importlib.resources import files
from typing import Any

from dmframe.certify import Verdict
from dmframe.config import Experiment
from dmframe.diagram import Diagram
from dmframe.page.content import content_of

SCRIPTS = ("solver.js", "scene.js", "plot.js", "page.js")
"""In the order in which they stand in the page."""


def page(experiment: Experiment, diagram: Diagram, verdict: Verdict) -> str:
    """The page as HTML."""
    return assembled(content_of(experiment, diagram, verdict))


def assembled(content: dict[str, Any]) -> str:
    """The page of some data."""
    web = files("dmframe.page").joinpath("web")
    texts = {name: web.joinpath(name).read_text("utf-8") for name in ("page.html", "page.css", *SCRIPTS)}
    data = json.dumps(content, ensure_ascii=False, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    parts = {
        "TITLE": _escaped(content["title"] or content["name"]),
        "STYLE": texts["page.css"],
        "DATA": data,
        "SCRIPT": "\n".join(texts[name] for name in SCRIPTS),
    }
    return re.sub("@([A-Z]+)@", lambda mark: parts[mark[1]], texts["page.html"])


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
