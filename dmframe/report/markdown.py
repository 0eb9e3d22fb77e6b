"""Markdown of the parts of a page: formulas between dollar signs, alternatives instead of pictures."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import assert_never

from dmframe.report.parts import (
    Badge,
    Bullets,
    Cell,
    Columns,
    Equations,
    Formula,
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


def section(given: Section) -> list[str]:
    """Blocks of a section, to be separated by blank lines."""
    return [f"## {given.title}", *blocks(given.parts)]


def blocks(parts: Sequence[Part]) -> list[str]:
    """The blocks of parts."""
    return [block for part in parts for block in _part(part) if block]


def _part(part: Part) -> list[str]:
    match part:
        case Paragraph():
            return [cell(part.text)]
        case Bullets():
            return ["\n".join(f"- {cell(item)}" for item in part.items)]
        case Table():
            return [cell(part.caption), table(part)]
        case Equations():
            return [_equation(row) for row in part.rows]
        case Listing():
            return [_listing(part)]
        case Picture():
            return [] if part.instead is None else _part(part.instead)
        case Titled():
            return [f"{part.title}:", *_part(part.part)]
        case Columns():
            return blocks(part.parts)
        case Subsection():
            title = f"### {plain(part.title)}" + (f" ({plain(part.detail)})" if part.detail else "")
            return [title, *blocks(part.parts)]
        case _:
            assert_never(part)


def table(given: Table) -> str:
    """Table; Markdown requires heads, so missing ones are empty."""
    heads: Sequence[Cell] = given.heads or [()] * len(given.rows[0])
    rule = ("---:" if column in given.numbers else "---" for column in range(len(heads)))
    return "\n".join([_line(heads), f"|{'|'.join(rule)}|", *map(_line, given.rows)])


def _line(cells: Sequence[Cell]) -> str:
    return f"|{'|'.join(' ' if each == () else f' {cell(each, bars=False)} ' for each in cells)}|"


def cell(given: Cell, *, bars: bool = True) -> str:
    """Content of a paragraph, item or table cell; ``bars=False`` escapes bars, for a table cell."""
    pieces = given if isinstance(given, tuple) else (given,)
    return "".join(_piece(piece, bars) for piece in pieces)


def _piece(piece: Piece, bars: bool) -> str:
    match piece:
        case str():
            return plain(piece) if bars else _unbarred(plain(piece))
        case Marked():
            return piece.text if bars else _in_cell(piece.text)
        case Formula():
            return f"${_vert(piece.latex)}$"
        case Word():
            return _word(_piece(piece.text, bars), piece.kind)
        case Link() | Badge():
            return _piece(piece.text, bars)
        case _:
            assert_never(piece)


def plain(text: str) -> str:
    """Escape a text: it starts no element, formula, code, link or emphasis."""
    return re.sub(r"[`$]|\]\(|\*\*", lambda mark: "\\" + mark[0], re.sub(r"<(?=[A-Za-z/!?])", "&lt;", text))


def _word(text: str, kind: str) -> str:
    match kind:
        case "code" | "command" | "file":
            return f"`{text}`"
        case "strong":
            return f"**{text}**"
        case "next":
            return f". {text}"
        case _:
            return text


def _in_cell(text: str) -> str:
    """Marked text in a table."""
    parts = re.split(r"(\$[^$]+\$)", text)
    return "".join(_vert(part) if part.startswith("$") else _unbarred(part) for part in parts)


def _unbarred(text: str) -> str:
    return text.replace("|", r"\|").replace("\n", " ")


def _vert(latex: str) -> str:
    r"""Replace bars by ``\vert``, which does not end a table cell."""
    return re.sub(r"(?<!\\)\|", r"\\vert ", latex)


def _equation(row: Row) -> str:
    tag = rf" \tag{{{row.tag}}}" if row.tag else ""
    return f"$$\n{row.left} {row.right}{tag}\n$$".replace("\n ", "\n")


def _listing(given: Listing) -> str:
    """Fence with more backticks than the longest run in the text."""
    longest = max((len(run) for run in re.findall("`+", given.text)), default=0)
    fence = "`" * max(3, longest + 1)
    return f"{fence}{given.language}\n{given.text.strip()}\n{fence}"
