"""A block's page, read from its docstring: prose, numbered equations, notes and sources."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, final

from dmframe.block import AbstractBlock

_SECTION: Final = re.compile(r"^([A-Z][A-Za-z ]+)\n-{3,}$", re.MULTILINE)
_MATH: Final = re.compile(r"^\.\. math::[ \t]*\n((?:[ \t]+\S.*\n?|[ \t]*\n)+)", re.MULTILINE)
_TAG: Final = re.compile(r"\\tag\{([^}]*)\}")


@final
@dataclass(frozen=True)
class Row:
    r"""One line of aligned equations: what stands left and right of ``&``, and its number."""

    left: str
    right: str
    tag: str = ""


@final
@dataclass(frozen=True)
class Law:
    """What a block's docstring says.

    Parameters
    ----------
    summary
        Its first sentence.
    body
        Marked text (see `notation`) and groups of equations, in their order.
    parameters
        What each parameter is, as marked text.
    notes, source
        Marked text.
    """

    summary: str
    body: tuple[str | tuple[Row, ...], ...] = ()
    parameters: Mapping[str, str] = field(default_factory=dict)
    notes: str = ""
    source: str = ""


def law_of(block: type[AbstractBlock]) -> Law:
    """Read a block's docstring; what it leaves out is empty."""
    text = inspect.cleandoc(block.__doc__ or "")
    pieces = _SECTION.split(text)
    sections = dict(zip(pieces[1::2], pieces[2::2], strict=True))
    summary, _, body = pieces[0].partition("\n\n")
    return Law(
        summary=prose(summary),
        body=tuple(_body(body)),
        parameters=_parameters(sections.get("Parameters", "")),
        notes=prose(sections.get("Notes", "")),
        source=prose(sections.get("References", "")),
    )


def prose(text: str) -> str:
    """Marked text from the reStructuredText of docstrings."""
    text = re.sub(r":math:`([^`]*)`", lambda found: f"${' '.join(found[1].split())}$", text)
    text = re.sub(r"``([^`]*)``", r"`\1`", text)
    text = re.sub(r"\[(\w+)\]_", r"[\1]", text)
    return " ".join(text.split())


def _body(text: str) -> list[str | tuple[Row, ...]]:
    """Paragraphs and equations, in order."""
    parts: list[str | tuple[Row, ...]] = []
    for index, piece in enumerate(_MATH.split(text)):
        if index % 2:
            parts.append(rows_of(piece))
        else:
            parts += [prose(paragraph) for paragraph in re.split(r"\n\s*\n", piece) if paragraph.strip()]
    return parts


def rows_of(block: str) -> tuple[Row, ...]:
    r"""Lines of aligned equations, split at ``\\`` and then at the first ``&``; a blank line ends an equation."""
    rows = list[Row]()
    for group in re.split(r"\n\s*\n", block.strip("\n")):
        for line in _lines(group):
            tag = _TAG.search(line)
            bare = " ".join(_TAG.sub("", line).split())
            left, aligned, right = bare.partition("&") if bare.find("&") < _inner(bare) else (bare, "", "")
            if bare:
                rows.append(Row(left.strip(), right.strip(), tag[1] if tag else "") if aligned else _split(bare, tag))
    return tuple(rows)


def _inner(line: str) -> int:
    """Where the first inner environment begins, whose own ``&`` align nothing here; the line's end without one."""
    place = line.find(r"\begin{")
    return place if place >= 0 else len(line)


def _split(line: str, tag: re.Match[str] | None) -> Row:
    """A lone equation, split at its first equals sign outside of braces."""
    depth = 0
    for place, letter in enumerate(line):
        depth += {"{": 1, "}": -1, "(": 1, ")": -1}.get(letter, 0)
        if letter == "=" and depth == 0:
            return Row(line[:place].strip(), line[place:].strip(), tag[1] if tag else "")
    return Row("", line, tag[1] if tag else "")


def _lines(text: str) -> list[str]:
    r"""Split at ``\\`` outside of environments such as cases."""
    lines, depth, start = list[str](), 0, 0
    for found in re.finditer(r"\\begin\{|\\end\{|\\\\", text):
        if found.group() == r"\\":
            if depth == 0:
                lines.append(text[start : found.start()])
                start = found.end()
        else:
            depth += 1 if "begin" in found.group() else -1
    return [*lines, text[start:]]


def _parameters(text: str) -> dict[str, str]:
    """``{"Gamma": "Adaptation gain. ..."}``; a line may name several."""
    found = dict[str, str]()
    for names, _, said in re.findall(r"^(\w+(?:, \w+)*) : ([^\n]*)\n((?:[ \t]+\S.*\n?)+)", text, re.MULTILINE):
        for name in names.split(", "):
            found[name] = prose(said)
    return found
