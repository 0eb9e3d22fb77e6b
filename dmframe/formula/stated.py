"""Equations of a docstring, displayed and in the text, each with its line in the file."""

from __future__ import annotations

import ast
import functools
import inspect
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final, final

from dmframe.block import AbstractBlock
from dmframe.formula.latex import tokens

_DISPLAYED: Final = re.compile(r"^([ \t]*)\.\.[ \t]+math[ \t]*::[ \t]*(.*)$", re.IGNORECASE)
_INLINE: Final = re.compile(r":math:`([^`]*)`", re.DOTALL | re.IGNORECASE)
_TAG: Final = re.compile(r"\\tag\{[^}]*\}")


@final
@dataclass(frozen=True)
class Stated:
    """An equation of a docstring: its sides as words, and the line of its file."""

    left: tuple[str, ...]
    right: tuple[str, ...]
    line: int
    displayed: bool
    source: str


def equations_of(block: type[AbstractBlock]) -> Iterator[Stated]:
    """All equations of a docstring, displayed and in the text, in the order of the file."""
    text = block.__dict__.get("__doc__") or ""
    _, first = source_of(block)
    lines = text.split("\n")
    place = 0
    while place < len(lines):
        head = _DISPLAYED.match(lines[place])
        if head is None:
            place += 1
            continue
        start, indent = place + 1, len(head[1])
        place += 1
        while place < len(lines) and (
            not lines[place].strip() or len(lines[place]) - len(lines[place].lstrip()) > indent
        ):
            place += 1
        body = [(first + number, lines[number]) for number in range(start, place)]
        if head[2].strip():
            body.insert(0, (first + start - 1, head[2]))
        yield from _rows(body)
    for found in _INLINE.finditer(text):
        line = first + text[: found.start()].count("\n")
        for words, source in _parts(found[1]):
            yield from _equation(words, line, displayed=False, source=source)


def source_of(block: type[AbstractBlock]) -> tuple[str, int]:
    """The file of a block, and the line on which its docstring begins; 0 if the file cannot be read."""
    file = Path(inspect.unwrap(block.equations).__code__.co_filename)
    return file.name, _lines(file).get(block.__name__, 0)


@functools.lru_cache(maxsize=256)
def _lines(file: Path) -> Mapping[str, int]:
    """The classes of a file, with the lines of their docstrings; cached, as modules are."""
    try:
        classes = [node for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.ClassDef)]
    except (OSError, SyntaxError, UnicodeDecodeError, ValueError):
        return {}
    return {node.name: node.body[0].lineno for node in reversed(classes)}


def _rows(body: Sequence[tuple[int, str]]) -> Iterator[Stated]:
    r"""Equations of a displayed group: rows end with ``\\`` or a blank line; a row without a left side continues."""
    rows: list[tuple[int, str]] = []
    fresh = True
    for line, text in body:
        bare = _TAG.sub("", text)
        if not bare.strip():
            fresh = True
            continue
        if fresh:
            rows.append((line, ""))
        pieces = _row_ends(bare)
        for number, piece in enumerate(pieces):
            if number:
                rows.append((line, ""))
            rows[-1] = (rows[-1][0] if rows[-1][1].strip() else line, rows[-1][1] + " " + piece)
        fresh = False
    joined = list[tuple[int, str]]()
    for line, row in (row for row in rows if row[1].strip()):
        left = row.partition("&")[0]
        if joined and "&" in row and not left.strip() and "=" not in row:
            joined[-1] = (joined[-1][0], joined[-1][1] + " " + row)
        else:
            joined.append((line, row))
    for line, row in joined:
        for words, source in _parts(row):
            yield from _equation(words, line, displayed=True, source=source)


def _row_ends(text: str) -> list[str]:
    r"""Split at ``\\`` outside of environments."""
    pieces, depth, start = list[str](), 0, 0
    for found in re.finditer(r"\\begin\{|\\end\{|\\\\", text):
        if found[0] == r"\\":
            if depth == 0:
                pieces.append(text[start : found.start()])
                start = found.end()
        else:
            depth += 1 if "begin" in found[0] else -1
    return [*pieces, text[start:]]


def _parts(text: str) -> Iterator[tuple[list[str], str]]:
    """Equations separated by commas."""
    words, depth, part = tokens(_TAG.sub("", text)), 0, list[str]()
    for word in words:
        depth += {"(": 1, "{": 1, "[": 1, ")": -1, "}": -1, "]": -1}.get(word, 0)
        if word in (",", ";") and depth == 0:
            if part:
                yield part, shown(part)
            part = []
        else:
            part.append(word)
    if part:
        yield part, shown(part)


def shown(words: Sequence[str]) -> str:
    """LaTeX from words."""
    text = ""
    for word in words:
        text += (" " if re.search(r"\\[A-Za-z]+$", text) and word[:1].isalpha() else "") + word
    return text


def _equation(words: list[str], line: int, *, displayed: bool, source: str) -> Iterator[Stated]:
    """One equation, or a chain a = b = c as two."""
    sides: list[list[str]] = [[]]
    depth = 0
    for word in words:
        depth += {"(": 1, "{": 1, ")": -1, "}": -1}.get(word, 0)
        if word == "=" and depth <= 0:
            sides.append([])
        else:
            sides[-1].append(word)
    if len(sides) == 1:
        if displayed:
            yield Stated((), tuple(sides[0]), line, displayed, source)
        return
    for left, right in pairwise(sides):
        yield Stated(tuple(left), tuple(right), line, displayed, source)
