"""What a page is made of, as values: said once, and written as HTML or as Markdown.

A plain `str` is text of anybody, and stands as it is. Only a `Marked` text is read: its formulas stand between dollar
signs, its code between backticks, and the keys of its sources in square brackets.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias, final

from dmframe.report.rows import Row

MARKED: Final = re.compile(r"\$([^$]+)\$|`([^`]+)`|\[([A-Z]\w+\d{4}\w?)\]")
"""A formula, code or a source in a marked text."""


@final
@dataclass(frozen=True)
class Marked:
    """A sentence with its formulas, code and sources marked."""

    text: str


@final
@dataclass(frozen=True)
class Formula:
    """LaTeX, which may be broken between its terms; `display` with tall fractions, `whole` that and never broken."""

    latex: str
    how: Literal["inline", "display", "whole"] = "inline"


@final
@dataclass(frozen=True)
class Word:
    """A text of its own kind.

    `long` has no blanks at which a line could break, `strong` is a warning, `small` is said aside, `next` aside on a
    line of its own; `command` is long code.
    """

    text: str | Marked
    kind: Literal["code", "command", "long", "strong", "small", "next"]


@final
@dataclass(frozen=True)
class Link:
    """A text that leads to another place of the page."""

    text: str
    to: str


@final
@dataclass(frozen=True)
class Badge:
    """An outcome in a word or two, in its colour."""

    text: str
    outcome: str


Piece: TypeAlias = str | Marked | Formula | Word | Link | Badge
Cell: TypeAlias = Piece | tuple[Piece, ...]
"""What stands in a cell, a paragraph or an item: pieces one after another."""


@final
@dataclass(frozen=True)
class Paragraph:
    """A paragraph; a note is said in passing."""

    says: Cell
    note: bool = False


@final
@dataclass(frozen=True)
class Bullets:
    """A list; the items at the places `failing` are what is wrong. A `dense` one has short items."""

    items: Sequence[Cell]
    failing: Sequence[int] = ()
    dense: bool = False


@final
@dataclass(frozen=True)
class Table:
    """A table.

    Parameters
    ----------
    kind
        Of which tables it is one: the style sheet knows it.
    keys
        Whether the first cell of a row is its head.
    numbers
        The columns of numbers, which stand to the right.
    failing
        The rows of what is wrong.
    """

    rows: Sequence[Sequence[Cell]]
    heads: Sequence[Cell] = ()
    caption: Cell = ()
    kind: str = ""
    keys: bool = False
    numbers: Sequence[int] = ()
    failing: Sequence[int] = ()


@final
@dataclass(frozen=True)
class Equations:
    """Lines of aligned equations."""

    rows: Sequence[Row]


@final
@dataclass(frozen=True)
class Listing:
    """A text of some lines in a language of machines."""

    text: str
    language: str


@final
@dataclass(frozen=True)
class Picture:
    """A stand-alone SVG with its caption; `name` tells it from the others of a graph.

    A `wide` one may be wider than the text; `instead` is what a page without pictures has in its place.
    """

    svg: str
    name: str
    caption: Cell
    kind: Literal["diagram", "plot"] = "plot"
    wide: bool = False
    instead: Listing | Table | None = None


@final
@dataclass(frozen=True)
class Titled:
    """A short title, and what belongs to it."""

    title: str
    part: Part


@final
@dataclass(frozen=True)
class Columns:
    """Two titled parts side by side, where there is room."""

    parts: Sequence[Titled]


@final
@dataclass(frozen=True)
class Subsection:
    """A part of a section that has a heading; `detail` stands beside it. A `law` is set apart."""

    title: str
    parts: Sequence[Part]
    detail: str = ""
    law: bool = False


Part: TypeAlias = Paragraph | Bullets | Table | Equations | Listing | Picture | Titled | Columns | Subsection


@final
@dataclass(frozen=True)
class Section:
    """A section; `name` is its place in links. A `wide` one is printed across."""

    name: str
    title: str
    parts: Sequence[Part]
    wide: bool = False


@final
@dataclass(frozen=True)
class Lead:
    """A verdict in one sentence."""

    outcome: str
    headline: str
    sentence: Marked
