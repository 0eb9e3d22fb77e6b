"""HTML of the parts of a page: formulas in MathML, pictures in SVG, user texts escaped."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, assert_never, final
from urllib.parse import quote

from dmframe.common.exponents import typeset
from dmframe.common.notebook import embedded
from dmframe.report.mathml import breakable, mathml, terms
from dmframe.report.parts import (
    MARKED,
    Badge,
    Bullets,
    Cell,
    Columns,
    Equations,
    Formula,
    Lead,
    Link,
    Listing,
    Marked,
    Paragraph,
    Part,
    Picture,
    Piece,
    Row,
    Section,
    Subsection,
    Table,
    Titled,
    Word,
)
from dmframe.report.tags import Html, joined, plain, tag

SHORT: Final = 48
"""Length [characters of LaTeX] up to which a formula in a sentence is not broken."""
VERBATIM: Final = ("code", "command", "file", "long")
"""Kinds of words that are printed as they are."""
_EMPTY: Final = Html("")


def cell(given: Cell) -> Html:
    """Content of a table cell, paragraph or list item."""
    pieces = given if isinstance(given, tuple) else (given,)
    return joined(map(_piece, pieces), "")


def _piece(piece: Piece) -> Html:
    match piece:
        case str():
            return plain(typeset(piece))
        case Marked():
            return _marked(piece.text)
        case Formula(latex, "whole"):
            return tag("span", mathml(latex, display=True), class_="signal")
        case Formula(latex, how):
            return tag("span", breakable(latex, display=how == "display"), class_="f")
        case Word(str() as text, "file"):
            return tag("a", tag("code", plain(text)), href=quote(text))
        case Word(str() as text, kind) if kind in VERBATIM:
            return _word(plain(text), kind)
        case Word():
            return _word(cell(piece.text), piece.kind)
        case Link(text, to):
            return tag("a", plain(text), href=f"#{to}")
        case Badge(text, outcome):
            return tag("span", plain(text), class_=f"badge {outcome}")
        case _:
            assert_never(piece)


def _word(text: Html, kind: str) -> Html:
    match kind:
        case "code":
            return tag("code", text)
        case "command":
            return tag("code", text, class_="command")
        case "strong":
            return tag("strong", text)
        case "next":
            return joined([Html("<br/>"), tag("span", text, class_="source")], "")
        case "small":
            return tag("span", text, class_="source")
        case _:
            return tag("span", text, class_=kind)


def _marked(text: str) -> Html:
    out, place = list[Html](), 0
    for found in MARKED.finditer(text):
        out.append(plain(typeset(text[place : found.start()])))
        formula, code, key = found.groups()
        if formula:
            out.append(mathml(formula) if len(formula) < SHORT else breakable(formula))
        else:
            out.append(tag("code", plain(code)) if code else tag("a", plain(f"[{key}]"), href=f"#{key}"))
        place = found.end()
    return joined([*out, plain(typeset(text[place:]))], "")


@final
class Writer:
    """Writer of parts; `prefix` makes the anchors of one graph unique on the page."""

    def __init__(self, prefix: str) -> None:
        self.prefix = prefix

    def section(self, given: Section) -> Html:
        """A section under its heading."""
        wide = "landscape" if given.wide else ""
        inside = [tag("h2", plain(given.title)), *(self.part(part) for part in given.parts)]
        return tag("section", joined(inside), id=f"{self.prefix}-{given.name}", class_=wide)

    def contents(self, name: str, given: Sequence[Section]) -> Html:
        """Table of contents with links to the sections."""
        items = [tag("li", cell(Link(each.title, f"{self.prefix}-{each.name}"))) for each in given]
        return tag("nav", tag("ol", joined(items)), aria_label=f"contents of {name}")

    def part(self, part: Part) -> Html:
        """One part."""
        match part:
            case Paragraph():
                return tag("p", cell(part.text), class_="note" if part.note else "")
            case Bullets():
                items = [
                    tag("li", cell(item), class_="fails" if place in part.failing else "")
                    for place, item in enumerate(part.items)
                ]
                return tag("ul", joined(items), class_="dense" if part.dense else "")
            case Table():
                return table(part)
            case Equations():
                return tag("div", joined(map(_equation, _aligned(part.rows))), class_="equations", role="group")
            case Listing():
                return tag("pre", plain(part.text))
            case Picture():
                svg = Html(embedded(part.svg, f"{self.prefix}-{part.name}"))
                kind = f"{part.kind} wide" if part.wide else part.kind
                return tag("figure", svg, tag("figcaption", cell(part.caption)), class_=kind)
            case Titled():
                return joined([tag("h3", plain(part.title)), self.part(part.part)])
            case Columns():
                return tag("div", *(tag("div", self.part(each)) for each in part.parts), class_="columns")
            case Subsection():
                return self._subsection(part)
            case _:
                assert_never(part)

    def _subsection(self, given: Subsection) -> Html:
        detail = [Html(" "), tag("span", plain(given.detail), class_="detail")] if given.detail else []
        heading = tag("h3", plain(given.title), *detail)
        return tag("section", joined([heading, *map(self.part, given.parts)]), class_="law" if given.law else "")


def lead(given: Lead) -> Html:
    """Verdict as a highlighted section."""
    headline = tag("strong", plain(given.headline))
    line = tag("p", headline, plain(": "), cell(given.sentence), class_="headline")
    return tag("section", line, class_=f"verdict {given.outcome}")


def table(given: Table) -> Html:
    """A table with its caption."""
    parts = [tag("caption", cell(given.caption))] if given.caption else []
    if given.heads:
        heads = [tag("th", cell(head), scope="col", class_=_kind(given, k)) for k, head in enumerate(given.heads)]
        parts.append(tag("thead", tag("tr", *heads)))
    rows = [
        tag(
            "tr",
            *(_entry(given, column, each) for column, each in enumerate(row)),
            class_="fails" if k in given.failing else "",
        )
        for k, row in enumerate(given.rows)
    ]
    return tag("table", joined([*parts, tag("tbody", joined(rows))]), class_=given.kind)


def _entry(given: Table, column: int, content: Cell) -> Html:
    if given.keys and column == 0:
        return tag("th", cell(content), scope="row")
    return tag("td", cell(content), class_=_kind(given, column))


def _kind(given: Table, column: int) -> str:
    return "number" if column in given.numbers else ""


def _equation(row: Row) -> Html:
    left = mathml(row.left, display=True) if row.left else _EMPTY
    right = breakable(row.right, display=True)
    number = plain(f"({row.tag})") if row.tag else _EMPTY
    spans = (("left", left), ("right", right), ("tag", number))
    return tag("div", *(tag("span", inside, class_=name) for name, inside in spans), class_="eq")


def _aligned(rows: Sequence[Row]) -> list[Row]:
    """Rows for alignment; a left side of more than two terms is joined to its right side."""
    return [Row("", f"{row.left} {row.right}", row.tag) if len(terms(row.left)) > 2 else row for row in rows]
