"""Elements of a page, independent of HTML and Markdown.

A plain `str` is escaped. A `Marked` text is parsed: formulas between dollar signs, code between backticks, keys of
sources in square brackets.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias, final

MARKED: Final = re.compile(r"\$([^$]+)\$|`([^`]+)`|\[([A-Z]\w+\d{4}\w?)\]")
"""A formula, code or a source in a marked text."""


@final
@dataclass(frozen=True)
class Row:
    """Line of aligned equations: left side, right side, number."""

    left: str
    right: str
    tag: str = ""


@final
@dataclass(frozen=True)
class Marked:
    """Sentence with marked formulas, code and sources."""

    text: str


@final
@dataclass(frozen=True)
class Formula:
    """LaTeX formula; `display`: display style, `whole`: display style without line breaks."""

    latex: str
    how: Literal["inline", "display", "whole"] = "inline"


@final
@dataclass(frozen=True)
class Word:
    """Text with a style.

    `long`: without blanks, may break anywhere; `strong`: warning; `small`: remark; `next`: remark on its own line;
    `command`: long code; `file`: file next to the page.
    """

    text: str | Marked
    kind: Literal["code", "command", "file", "long", "strong", "small", "next"]


@final
@dataclass(frozen=True)
class Link:
    """Link to another place on the page."""

    text: str
    to: str


@final
@dataclass(frozen=True)
class Badge:
    """Coloured label of an outcome."""

    text: str
    outcome: str


Piece: TypeAlias = str | Marked | Formula | Word | Link | Badge
Cell: TypeAlias = Piece | tuple[Piece, ...]
"""Content of a table cell, paragraph or list item."""


@final
@dataclass(frozen=True)
class Paragraph:
    """Paragraph; a note is set in small type."""

    text: Cell
    note: bool = False


@final
@dataclass(frozen=True)
class Bullets:
    """List; `failing` are the indices of highlighted items, `dense` reduces the spacing."""

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
        Class for the style sheet.
    keys
        Whether the first cell of a row is its head.
    numbers
        Indices of right-aligned columns.
    failing
        Indices of highlighted rows.
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
    """Aligned equations."""

    rows: Sequence[Row]


@final
@dataclass(frozen=True)
class Listing:
    """Code or data listing."""

    text: str
    language: str


@final
@dataclass(frozen=True)
class Picture:
    """Stand-alone SVG with a caption; `name` is unique within a graph.

    A `wide` picture may exceed the text width; Markdown shows `instead`.
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
    """Part with a short title."""

    title: str
    part: Part


@final
@dataclass(frozen=True)
class Columns:
    """Titled parts side by side on a wide page."""

    parts: Sequence[Titled]


@final
@dataclass(frozen=True)
class Subsection:
    """Subsection; `detail` follows its heading, `law` selects the style of a block's law."""

    title: str
    parts: Sequence[Part]
    detail: str = ""
    law: bool = False


Part: TypeAlias = Paragraph | Bullets | Table | Equations | Listing | Picture | Titled | Columns | Subsection


@final
@dataclass(frozen=True)
class Section:
    """Section; `name` is its anchor, a `wide` one is printed in landscape."""

    name: str
    title: str
    parts: Sequence[Part]
    wide: bool = False


@final
@dataclass(frozen=True)
class Lead:
    """Verdict in one sentence."""

    outcome: str
    headline: str
    sentence: Marked
