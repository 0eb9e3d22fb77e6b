"""Sphinx extension of the site: live pages, formulas without a network, lessons as notebooks."""

from __future__ import annotations

import shlex
import time
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config
from sphinx.ext.napoleon.docstring import NumpyDocstring
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

from dmframe.common.errors import DmframeError
from dmframe.lessons import lessons, notebook
from site_parts import live, mathematics

LOG = logging.getLogger(__name__)
COURSE = "course/"
BEGUN = time.time()
"""A live page newer than this belongs to this build: each is written once, by the first process that needs it."""
NUMPYDOC = Config(napoleon_use_ivar=True, napoleon_use_rtype=False, napoleon_attr_annotations=True)


class Live(SphinxDirective):
    """``{live} GRAPH``: the live page of a graph, written and embedded.

    The graph is a packaged one or a file next to the page. Options: `set`, values as after ``--set``, several between
    blanks; `height` [pixels]; `title`; `still`, a picture that is shown until the page is there; `wide`, wider than the
    text. The body, if there is one, is the graph itself, and the argument its name.
    """

    required_arguments = 1
    has_content = True
    option_spec: ClassVar[dict[str, Any]] = {
        "set": directives.unchanged,
        "height": directives.positive_int,
        "title": directives.unchanged,
        "still": directives.unchanged,
        "wide": directives.flag,
    }

    def run(self) -> list[nodes.Node]:
        """The frame, as HTML; other formats show the title only."""
        name, settings = self.arguments[0], self.options.get("set", "")
        up = "../" * self.env.docname.count("/")
        try:
            graph = live.graph_of(self._source(name), settings)
            place = live.file_of(graph, settings)
            path = Path(self.env.app.outdir) / place
            if not (path.is_file() and path.stat().st_mtime > BEGUN):
                live.write(graph, path)
        except DmframeError as error:
            raise self.error(f"live {name}: {error}") from None
        except FileNotFoundError as error:
            LOG.warning("live %s: %s", name, error, location=self.get_location(), type="live")
            return [nodes.raw("", live.missing(name, "this version cannot write it."), format="html")]
        packaged = not self.content and not name.endswith((".yaml", ".yml"))
        words = ["dmframe", "page", name, *(word for item in shlex.split(settings) for word in ("--set", item))]
        html = live.embedded(
            up + place,
            self.options.get("title") or graph.title or graph.name,
            self.options.get("height", live.HEIGHT),
            still=self._still(up),
            wide="wide" in self.options,
            command=words if packaged else (),
        )
        return [nodes.raw("", html, format="html")]

    def _source(self, name: str) -> Any:
        if self.content:
            return "\n".join(self.content) + "\n"
        if name.endswith((".yaml", ".yml")):
            return Path(self.env.doc2path(self.env.docname)).parent / name
        return name

    def _still(self, up: str) -> str:
        """The picture's address; it is copied here, since Sphinx copies only pictures that it shows itself."""
        if "still" not in self.options:
            return ""
        _, absolute = self.env.relfn2path(self.options["still"])
        self.env.note_dependency(absolute)
        return up + live.still(Path(absolute), Path(self.env.app.outdir))


def inline_math(self: Any, node: nodes.math) -> None:
    """A formula within a line."""
    self.body.append(_rendered(mathematics.inline, node))
    raise nodes.SkipNode


def block_math(self: Any, node: nodes.math_block) -> None:
    """Displayed formulas."""
    mark = f' id="{node["ids"][0]}"' if node.get("ids") else ""
    self.body.append(f"<div{mark}>{_rendered(mathematics.display, node)}</div>")
    raise nodes.SkipNode


def _rendered(make: Any, node: nodes.Element) -> str:
    try:
        return str(make(node.astext()))
    except mathematics.MathError as error:
        LOG.warning("%s", error, location=node, type="math")
        return f"<code>{nodes.unescape(node.astext())}</code>"


def take_away(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: nodes.document | None) -> None:
    """Below a lesson's title, its number, by which other lessons name it, and the lesson as a notebook."""
    if not page.startswith(COURSE) or "body" not in context:
        return
    path = Path(app.env.doc2path(page))
    lesson = next((lesson for lesson in lessons(path.parent).values() if lesson.path == path), None)
    if lesson is None:
        return
    name = f"lesson_{lesson.number:02}_{lesson.name}.ipynb"
    folder = Path(app.outdir, COURSE)
    folder.mkdir(parents=True, exist_ok=True)
    folder.joinpath(name).write_text(notebook(lesson), encoding="utf-8")
    link = f'<p class="take-away"><a href="{name}" download>Download this lesson as a notebook</a></p>'
    number = f'<p class="take-away">Lesson {lesson.number} of the course</p>'
    context["body"] = context["body"].replace("</h1>", f"</h1>{number}{link}", 1)


def read_docstring(app: Sphinx, what: str, name: str, of: Any, options: Any, lines: list[str]) -> None:
    """A docstring in numpydoc's form, as reStructuredText.

    Sphinx's own extension reads the text before a colon in a property's docstring as its type.
    """
    kind = "method" if what in ("property", "attribute", "data") else what
    lines[:] = NumpyDocstring(list(lines), NUMPYDOC, app, kind, name, of, options).lines()


def read_signature(
    app: Sphinx, what: str, name: str, of: Any, options: Any, signature: str | None, returns: str | None
) -> tuple[str, str | None] | None:
    """A valid Python signature: a dataclass shows a default that is created by a factory as ``<factory>``."""
    return None if signature is None else (signature.replace("<factory>", "..."), returns)


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("live", Live)
    app.add_html_math_renderer("dmframe", (inline_math, None), (block_math, None))
    app.connect("autodoc-process-docstring", read_docstring)
    app.connect("autodoc-process-signature", read_signature)
    app.connect("html-page-context", take_away)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
