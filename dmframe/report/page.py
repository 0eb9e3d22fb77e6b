"""Reports as one self-contained web page and as Markdown; frame of such a page."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from typing import Final

from dmframe.report import html, markdown, sections
from dmframe.report.content import Content, Opening
from dmframe.report.parts import MARKED, Badge, Link, Table
from dmframe.report.references import reference
from dmframe.report.tags import Html, joined, plain, tag

_POLICY: Final = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
_STYLES: Final = ("look.css", "report.css")
"""Colours and fonts, which live pages have too, and the layout of a report."""
_NARROW: Final = Html("""\
.dmframe p { margin: 0.4em 0 }
.dmframe .columns { display: flex; gap: 2em }
.dmframe .columns > div { flex: 1 }
.dmframe h3 { font-size: 1em; margin: 0.6em 0 0.2em }
.dmframe ul { margin: 0; padding-left: 1.2em }""")


def as_html(contents: Sequence[Content]) -> str:
    """One file without external resources: formulas in MathML, pictures in SVG."""
    one = contents[0] if len(contents) == 1 else None
    names = ", ".join(content.name for content in contents)
    title = f"{one.name}: {one.meaning.headline.lower()}" if one else f"Certificates of {names}"
    kind = tag("p", plain("Certificate of a control loop"), class_="doc-kind")
    named = _named(one) if one else [tag("h1", plain(f"{len(contents)} graphs")), html.table(_overview(contents))]
    articles = [_article(content, f"g{place}", one is None) for place, content in enumerate(contents, start=1)]
    return document(title, [tag("header", joined([kind, *named])), *articles, *_sources(contents)])


def document(title: str, body: Sequence[Html]) -> str:
    """Web page in one file without external resources; `title` is the browser title."""
    head = [
        Html('<meta charset="utf-8"/>'),
        Html(f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}"/>'),
        Html('<meta name="viewport" content="width=device-width, initial-scale=1"/>'),
        tag("title", plain(title)),
        tag(
            "style",
            Html("".join(files("dmframe.report").joinpath(name).read_text(encoding="utf-8") for name in _STYLES)),
        ),
    ]
    page = tag("html", tag("head", joined(head)), Html("\n"), tag("body", joined(body)), lang="en")
    return f"<!DOCTYPE html>\n{page}\n"


def _style(name: str) -> str:
    return files("dmframe.report").joinpath(name).read_text(encoding="utf-8")


def _named(content: Content, kind: str = "") -> list[Html]:
    title = [tag("p", plain(content.title), class_="doc-title")] if content.title else []
    return [tag("h1", plain(content.name), class_=kind), *title]


def _overview(contents: Sequence[Content]) -> Table:
    rows = [
        (Link(content.name, f"g{place}"), Badge(content.meaning.headline, content.outcome), content.title)
        for place, content in enumerate(contents, start=1)
    ]
    return Table(rows, ("graph", "verdict", "title"), kind="overview")


def _article(content: Content, prefix: str, named: bool) -> Html:
    writer, parts = html.Writer(prefix), list(sections.sections(content))
    head = [*(_named(content, "graph") if named else []), html.lead(sections.lead(content))]
    inside = [*head, writer.contents(content.name, parts), *map(writer.section, parts)]
    return tag("article", joined(inside), id=prefix)


def _sources(contents: Sequence[Content]) -> list[Html]:
    entries = [tag("dt", plain(f"[{key}]"), id=key) + tag("dd", plain(text)) for key, text in _cited(contents)]
    listed = tag("dl", joined(map(Html, entries)))
    return [tag("section", tag("h2", plain("Sources")), listed, id="references")] if entries else []


def as_markdown(contents: Sequence[Content]) -> str:
    """Markdown with formulas between dollar signs and the block diagram as Mermaid."""
    one = contents[0] if len(contents) == 1 else None
    title = f"{one.name}: {one.meaning.headline.lower()}" if one else f"Certificates of {len(contents)} graphs"
    out = [f"# {markdown.plain(title)}", *([] if one else [markdown.table(_overview(contents))])]
    for content in contents:
        lead = sections.lead(content)
        out += [] if one else [f"# {markdown.plain(content.name)}"]
        out += [markdown.plain(content.title), f"> **{lead.headline}**: {lead.sentence.text}"]
        out += [block for section in sections.sections(content) for block in markdown.section(section)]
    cited = "\n".join(f"- [{key}] {text}" for key, text in _cited(contents))
    out += ["## Sources", cited] if cited else []
    return "\n\n".join(block for block in out if block) + "\n"


def first_page(opening: Opening) -> str:
    """First page of a report as an HTML fragment for a notebook."""
    title = f": {opening.title}" if opening.title else ""
    name = tag("p", tag("b", plain(opening.name)), plain(title))
    writer = html.Writer("first")
    parts = [tag("style", _NARROW), name, html.lead(sections.lead(opening))]
    return tag("div", joined([*parts, *map(writer.part, sections.first_page(opening))]), class_="dmframe")


def _cited(contents: Sequence[Content]) -> list[tuple[str, str]]:
    """Cited sources: keys and full titles."""
    texts = [
        text
        for content in contents
        for block in content.laws
        for text in (block.law.summary, block.law.source, block.law.notes)
    ]
    keys = sorted({found[3] for text in texts for found in MARKED.finditer(text) if found[3]})
    return [(key, reference(key)) for key in keys]
