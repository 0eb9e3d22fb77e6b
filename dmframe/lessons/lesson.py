"""Lessons: pages of MyST Markdown with Python cells, ``NN_short_name.md``, whose header has the lesson's question."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from dmframe.common.errors import ValueFault

HOMES: Final = (Path(__file__).with_name("course"), Path(__file__).parents[2] / "docs" / "course")
"""Folders of lessons, of an installed package and of a checkout; the first existing one is used."""
_FILE: Final = re.compile(r"(\d\d)_(\w+)\.md")
_HEADER: Final = re.compile(r"\A---\n(.*?)\n---\n", re.DOTALL)
_FENCE: Final = re.compile(
    r"^(?P<mark>`{3,})(?:\{(?P<directive>[\w-]+)\}[ ]*(?P<argument>[^\n]*)|\w*)\n(?P<body>.*?)^(?P=mark)[ ]*$\n?",
    re.MULTILINE | re.DOTALL,
)
_OPTION: Final = re.compile(r":([\w-]+):[ ]*([^\n]*)\n")


@final
@dataclass(frozen=True)
class Piece:
    """A piece of a lesson.

    Parameters
    ----------
    kind
        ``prose``, ``cell`` (Python), ``live`` (a graph's live page), or ``code`` (a fence of any other kind).
    text
        Text of the piece; for a live page, the graph, if it is in the lesson.
    argument
        Name of a live page's graph.
    options
        Options by name, such as the tags of a cell.
    """

    kind: str
    text: str
    argument: str = ""
    options: tuple[tuple[str, str], ...] = ()

    @property
    def tags(self) -> tuple[str, ...]:
        """A cell's tags, such as ``solution``."""
        return tuple(re.findall(r"[\w-]+", dict(self.options).get("tags", "")))


@final
@dataclass(frozen=True)
class Lesson:
    """One lesson, with its question, and its duration in minutes."""

    number: int
    name: str
    title: str
    question: str
    minutes: int
    path: Path

    @property
    def body(self) -> str:
        """Page without the header."""
        return _HEADER.sub("", self.path.read_text(encoding="utf-8"))

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """Text, cells and live pages, in order, without the cells for tests, tagged ``remove-cell``."""
        return tuple(piece for piece in _pieces(self.body) if "remove-cell" not in piece.tags)


def lessons(folder: Path | None = None) -> dict[int, Lesson]:
    """Lessons by number; none if no course is installed. Raises `ValueFault` for a lesson without a header."""
    home = folder or next((home for home in HOMES if home.is_dir()), None)
    found = dict[int, Lesson]()
    for path in sorted(home.glob("*.md")) if home is not None else ():
        if named := _FILE.fullmatch(path.name):
            found[int(named[1])] = _lesson(path, int(named[1]), named[2])
    return found


def _lesson(path: Path, number: int, name: str) -> Lesson:
    text = path.read_text(encoding="utf-8")
    header, title = _HEADER.match(text), re.search(r"^# (.+)$", text, re.MULTILINE)
    data = _read(header[1]) if header is not None else {}
    try:
        question, minutes = str(data["lesson"]["question"]), int(data["lesson"]["minutes"])
    except (KeyError, TypeError, ValueError):
        raise ValueFault(f"{path.name}: expected a header with lesson: {{question: ..., minutes: ...}}") from None
    if title is None:
        raise ValueFault(f"{path.name}: expected a title, a line that begins with #")
    return Lesson(number, name, title[1].strip(), question, minutes, path)


def _read(header: str) -> dict[str, Any]:
    try:
        data = YAML(typ="safe").load(header)
    except YAMLError:
        return {}
    return data if isinstance(data, dict) else {}


def _pieces(body: str) -> Iterator[Piece]:
    last = 0
    for fence in _FENCE.finditer(body):
        yield from _prose(body[last : fence.start()])
        options, text = _options(fence["body"]) if fence["directive"] else ((), fence["body"])
        kinds = {"code-cell": "cell", "live": "live"}
        kind = kinds.get(fence["directive"] or "", "code")
        yield Piece(kind, text.strip("\n"), (fence["argument"] or "").strip(), options)
        last = fence.end()
    yield from _prose(body[last:])


def _prose(text: str) -> Iterator[Piece]:
    if text.strip():
        yield Piece("prose", text.strip("\n"))


def _options(text: str) -> tuple[tuple[tuple[str, str], ...], str]:
    """Options at the beginning of a directive, and the rest."""
    found = list[tuple[str, str]]()
    while option := _OPTION.match(text):
        found.append((option[1], option[2].strip()))
        text = text[option.end() :]
    return tuple(found), text
