"""A report as one self-contained web page, and as Markdown."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from html import escape
from typing import Any

from dmframe.notebook import embedded
from dmframe.report.content import Content, Opening
from dmframe.report.linear import JOINT_HEADS
from dmframe.report.mathml import breakable, mathml, terms
from dmframe.report.references import reference
from dmframe.report.rows import Row

MARKED = re.compile(r"\$([^$]+)\$|`([^`]+)`|\[([A-Z]\w+\d{4}\w?)\]")

SHORT = 48
"""Characters of LaTeX up to which a formula in a sentence is not broken."""


def as_html(contents: Sequence[Content]) -> str:
    """One file: formulas in MathML, pictures in SVG, nothing fetched from anywhere."""
    return _rendered("report.html.jinja", contents, _html_filters(), escaped=True)


def as_markdown(contents: Sequence[Content]) -> str:
    """The same content, formulas between dollar signs, the diagram as Mermaid."""
    return re.sub(r"\n{3,}", "\n\n", _rendered("report.md.jinja", contents, _markdown_filters(), escaped=False))


def first_page(opening: Opening) -> str:
    """The verdict, what it means and what follows, as a part of a page: for a notebook."""
    return str(_template("first_page.html.jinja", _html_filters(), escaped=True).render(r=opening))


def _rendered(template: str, contents: Sequence[Content], filters: dict[str, Callable[..., Any]], escaped: bool) -> str:
    page = _template(template, filters, escaped)
    return str(page.render(reports=contents, references=_cited(contents), style=_style(), heads=JOINT_HEADS))


def _template(name: str, filters: dict[str, Callable[..., Any]], escaped: bool) -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("dmframe.report"),
        autoescape=escaped,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    environment.filters |= filters
    return environment.get_template(name)


def _style() -> str:
    from importlib.resources import files

    return files("dmframe.report").joinpath("templates", "report.css").read_text(encoding="utf-8")


def _cited(contents: Sequence[Content]) -> list[tuple[str, str]]:
    """Keys of the sources that the reports cite, with their full titles."""
    texts = [
        text
        for content in contents
        for block in content.laws
        for text in (block.law.summary, block.law.source, block.law.notes)
    ]
    keys = sorted({found[3] for text in texts for found in MARKED.finditer(text) if found[3]})
    return [(key, reference(key)) for key in keys]


def _html_filters() -> dict[str, Callable[..., Any]]:
    from markupsafe import Markup

    def rich(text: str) -> Any:
        out, place = "", 0
        for found in MARKED.finditer(text):
            out += escape(text[place : found.start()], quote=False)
            formula, code, key = found.groups()
            if formula:
                out += mathml(formula) if len(formula) < SHORT else breakable(formula)
            elif code:
                out += f"<code>{escape(code, quote=False)}</code>"
            else:
                out += f'<a href="#{key}">[{key}]</a>'
            place = found.end()
        return Markup(out + escape(text[place:], quote=False))

    def math(latex: str) -> Any:
        return Markup(f'<span class="f">{breakable(latex)}</span>')

    def display(latex: str) -> Any:
        return Markup(breakable(latex, display=True))

    def whole(latex: str) -> Any:
        return Markup(mathml(latex, display=True))

    def picture(svg: str, prefix: str) -> Any:
        return Markup(embedded(svg, prefix))

    return {
        "rich": rich,
        "math": math,
        "display": display,
        "whole": whole,
        "picture": picture,
        "width": _width,
        "units": _units,
        "aligned": _aligned,
    }


def _width(svg: str) -> float:
    """Of a picture, as it says itself."""
    found = re.search(r'<svg[^>]* width="([\d.]+)', svg)
    return float(found[1]) if found else 0.0


def _aligned(rows: Sequence[Row]) -> list[Row]:
    """Rows whose left sides are short enough to be aligned; a longer one joins its right side."""
    return [Row("", f"{row.left} {row.right}", row.tag) if len(terms(row.left)) > 2 else row for row in rows]


def _units(text: str) -> str:
    """A unit with its exponents raised."""
    return text.replace("^2", "²").replace("^3", "³")


def _markdown_filters() -> dict[str, Callable[..., Any]]:
    def math(latex: str) -> str:
        return f"${_bars(latex)}$"

    def cell(text: str) -> str:
        """Marked text in a table, in which a bar would end the cell."""
        parts = re.split(r"(\$[^$]+\$)", text)
        return "".join(_bars(part) if part.startswith("$") else part.replace("|", r"\|") for part in parts)

    def equation(row: Row) -> str:
        tag = rf" \tag{{{row.tag}}}" if row.tag else ""
        return f"$$\n{row.left} {row.right}{tag}\n$$".replace("\n ", "\n")

    return {"math": math, "cell": cell, "equation": equation, "units": _units}


def _bars(latex: str) -> str:
    r"""Bars as ``\vert``, which tables bear."""
    return re.sub(r"(?<!\\)\|", r"\\vert ", latex)
