"""Read a YAML text into plain data with the line and column of each value.

Scalars are those of the core schema of YAML 1.2. They are parsed here, since the library accepts more: ``on`` and
``yes`` are texts, ``1e-3`` is a number, and ``1_000`` is a text. Tags, directives and merge keys are rejected; anchors
are allowed, within limits.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, TypeAlias, final

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.events import (
    AliasEvent,
    DocumentStartEvent,
    MappingEndEvent,
    MappingStartEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
)

from dmframe.common.errors import DmframeError, DocumentError, MissingError, ValueFault, nearest, raise_all, visible
from dmframe.common.files import ROBOT_FILES
from dmframe.common.units import shorten
from dmframe.config.scalars import Scalar, plain_scalar
from dmframe.config.syntax import decimal_comma, plain_words

Plain: TypeAlias = "dict[str, Plain] | list[Plain] | str | int | float | bool | None"
Steps: TypeAlias = tuple[str | int, ...]

MOST_BYTES = 1_000_000
DEEPEST = 50
MOST_NODES = 100_000  # an alias counts each time it is used


@final
@dataclass(frozen=True)
class Kind:
    """Kind of a file: its name in messages, and its first line."""

    noun: str
    begins: str


GRAPH: Final = Kind("graph", "dmframe: 1")

UNPRINTABLE = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@final
@dataclass(frozen=True)
class Node:
    """A value with its line and column; line 0 without a text. `size` counts its values, each alias in full.

    `origin` is the override that set it instead of the file, ``--set task.gamma=2``.
    """

    line: int
    column: int
    value: Scalar | list[Node] | dict[str, tuple[Node, Node]]
    size: int = 1
    origin: str = ""

    def place(self, name: str) -> str:
        """Its place in the text of that name, or the override that set it."""
        return self.origin or (f"{name}:{self.line}:{self.column}" if self.line else name)


@final
@dataclass(frozen=True)
class Document:
    """A YAML mapping as plain data; `name` is the text's name in messages."""

    name: str
    data: dict[str, Any]
    root: Node = field(repr=False, compare=False)

    def with_root(self, root: Node) -> Document:
        """The same text with another mapping."""
        return Document(self.name, mapping_of(root), root)

    def locate(self, path: Sequence[str | int], key: bool = False) -> str:
        """Place of the value at `path`, or of its key: ``graph.yaml:9:31``.

        Without a value at `path` it is the place of the nearest ancestor's key, where the value can be added.
        """
        node, named, exact = self._at(path)
        return (named if key or not exact else node).place(self.name)

    def node(self, path: Sequence[str | int]) -> Node:
        """The node at `path`. Raises `KeyError` if there is none."""
        node, _, exact = self._at(path)
        if not exact:
            raise KeyError(path)
        return node

    def is_override(self, path: Sequence[str | int], key: bool = False) -> bool:
        """True if an override set the value that `locate` finds."""
        node, named, exact = self._at(path)
        return bool((named if key or not exact else node).origin)

    def origins_below(self, path: Sequence[str | int]) -> list[str]:
        """The overrides in the value that `locate` finds."""
        return list(dict.fromkeys(_origins_in(self._at(path)[0])))

    def _at(self, path: Sequence[str | int]) -> tuple[Node, Node, bool]:
        """The value at `path` with its key, or those of its nearest ancestor, and true if the value exists."""
        node, named = self.root, self.root
        for step in path:
            held = node.value
            if isinstance(held, dict) and isinstance(step, str) and step in held:
                named, node = held[step]
            elif isinstance(held, list) and isinstance(step, int) and 0 <= step < len(held):
                named = node = held[step]
            else:
                return node, named, False
        return node, named, True


def read_file(path: Path | str, kind: Kind = GRAPH) -> Document:
    """Read a graph file, or one of another kind.

    Raises `MissingError` if there is no such file, `DocumentError` if it cannot be read, and the errors of
    `read_document`.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            raw = file.read(MOST_BYTES + 1)
    except FileNotFoundError:
        near = nearest(path.name, _neighbours(path.parent))
        raise MissingError(f"expected a {kind.noun} file, found none; {near}", location=str(path)) from None
    except IsADirectoryError:
        text = f"expected a {kind.noun} file, found a folder; name a file in it"
        raise DocumentError(text, location=str(path)) from None
    except OSError as fault:
        reason = (fault.strerror or str(fault)).lower()
        raise DocumentError(f"cannot read this file: {reason}", location=str(path)) from None
    _check_size(len(raw), str(path), kind)
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError as fault:
        before = raw[: fault.start].decode("utf-8")
        place = _place(str(path), before, len(before))
        raise DocumentError(
            f"expected text in UTF-8, found the byte 0x{raw[fault.start]:02x}; save the file as UTF-8", location=place
        ) from None
    return read_document(text, str(path), kind)


def read_document(text: str, name: str, kind: Kind = GRAPH) -> Document:
    """Read a YAML text that consists of one mapping.

    Raises `DocumentError` and, for numbers that are not finite, `ValueFault`; several faults are raised as `Faults`.
    """
    root = (_root_of if len(text) <= _KEPT else _root_of.__wrapped__)(text.removeprefix("\ufeff"), name, kind)
    return Document(name, mapping_of(root), root)


_KEPT: Final = 20_000
"""Longest text whose nodes are kept: a race, a study and a session read the same graphs many times."""


@lru_cache(maxsize=128)
def _root_of(text: str, name: str, kind: Kind) -> Node:
    """The node of the mapping. Raises as `read_document`."""
    _check_size(len(text.encode("utf-8", "surrogatepass")), name, kind)
    if text.count(",") + text.count("\n") > MOST_NODES:  # before the parser, which takes seconds for as many values
        raise DocumentError(f"more than {MOST_NODES} values or lines; shorten the {kind.noun}", location=name)
    strange = UNPRINTABLE.search(text)
    if strange:
        raise DocumentError(unreadable(strange.group()), location=_place(name, text, strange.start()))
    reader = _Reader(name, kind)
    root: Node | None = None
    try:
        root = reader.document(text)
    except MarkedYAMLError as fault:
        problem, index = plain_words(fault, text)
        reader.faults.append(DocumentError(problem, location=_place(name, text, index)))
    except DocumentError as fault:
        reader.faults.append(fault)
    raise_all(sorted(reader.faults, key=_order))
    if root is None or root.value is None:
        raise DocumentError(f"expected a {kind.noun}, found nothing; {_begin(kind)}", location=f"{name}:1:1")
    if not isinstance(root.value, dict):
        found = f"keys with their values, found {_kind(root.value)}; {_begin(kind, name)}"
        raise DocumentError(f"expected a {kind.noun}, {found}", location=f"{name}:{root.line}:{root.column}")
    return root


def unreadable(letter: str) -> str:
    """Message for a control character."""
    return f"expected readable text, found the control character U+{ord(letter):04X}; remove it"


def _begin(kind: Kind, name: str = "") -> str:
    robot = "; `dmframe new` writes a graph of a robot" if name.lower().endswith(ROBOT_FILES) else ""
    return f"a {kind.noun} begins with {kind.begins}{robot}"


def _check_size(count: int, name: str, kind: Kind) -> None:
    if count > MOST_BYTES:
        raise DocumentError(f"a {kind.noun} is at most 1 MB; is this the right file?", location=name)


def _place(name: str, text: str, index: int) -> str:
    start = text.rfind("\n", 0, index) + 1
    return f"{name}:{text.count(chr(10), 0, index) + 1}:{index - start + 1}"


def _order(fault: DmframeError) -> tuple[int, int]:
    line, column = fault.location.split(":")[-2:]
    return int(line), int(column)


def _neighbours(folder: Path) -> list[str]:
    try:
        return [
            item.name for item in folder.iterdir() if item.suffix in {".yaml", ".yml"} and not item.name.startswith(".")
        ]
    except OSError:
        return []


def _kind(value: object) -> str:
    nouns: dict[type, str] = {dict: "a mapping", list: "a list"}
    return nouns.get(type(value)) or f"the value {shorten(str(value), 30)}"


def mapping_of(node: Node) -> dict[str, Any]:
    """A mapping's node as plain data."""
    return {key: _plain(value) for key, (_, value) in node.value.items()} if isinstance(node.value, dict) else {}


def _origins_in(node: Node) -> Iterator[str]:
    if node.origin:
        yield node.origin
        return
    below = node.value.values() if isinstance(node.value, dict) else [(item, item) for item in _items(node)]
    for _, value in below:
        yield from _origins_in(value)


def _items(node: Node) -> list[Node]:
    return node.value if isinstance(node.value, list) else []


def _plain(node: Node) -> Plain:
    """New dictionaries and lists, also for an alias, so that no two places in the data share one."""
    if isinstance(node.value, dict):
        return {key: _plain(value) for key, (_, value) in node.value.items()}
    if isinstance(node.value, list):
        return [_plain(item) for item in node.value]
    return node.value


class _Reader:
    """Builds nodes from the parser's events and collects the faults that do not prevent further reading."""

    def __init__(self, name: str, kind: Kind) -> None:
        self.name, self.noun = name, kind.noun
        self.faults: list[DmframeError] = []
        self._count = 0
        self._anchors: dict[str, Node | None] = {}  # None while the value of the anchor is being read

    def document(self, text: str) -> Node | None:
        # a stream, since the parser would open a file named by a text of one line
        events: Iterator[Any] = YAML(typ="safe", pure=True).parse(io.StringIO(text))
        root: Node | None = None
        for event in events:
            if isinstance(event, DocumentStartEvent):
                if root is not None:
                    raise self._fault(f"a second document begins here; a {self.noun} file holds one", event)
                if event.version or event.tags:
                    self._note(
                        f"directives (%) are not used in a {self.noun}; remove the lines that begin with %", event
                    )
                root = self._node(next(events), events, ())
        return root

    def _node(self, event: Any, events: Iterator[Any], path: Steps) -> Node:
        if len(path) > DEEPEST:
            raise self._fault(f"nested deeper than {DEEPEST} levels; a {self.noun} needs about four", event, path)
        self._count += 1
        self._bound(self._count, event, path)
        if isinstance(event, AliasEvent):
            return self._alias(event, path)
        anchor, mark = event.anchor, event.start_mark
        if anchor:
            self._anchors[anchor] = None
        value = self._value(event, events, path)
        node = Node(mark.line + 1, mark.column + 1, value, self._size(value, event, path))
        if anchor:
            self._anchors[anchor] = node
        return node

    def _value(self, event: Any, events: Iterator[Any], path: Steps) -> Scalar | list[Node] | dict[str, Any]:
        if event.tag is not None:
            tag = visible(str(event.tag)).replace("tag:yaml.org,2002:", "!!")
            self._note(f"tags such as {shorten(tag)} are not used in a {self.noun}; write the value alone", event, path)
        if isinstance(event, SequenceStartEvent):
            items: list[Node] = []
            while not isinstance(inner := next(events), SequenceEndEvent):
                items.append(self._node(inner, events, (*path, len(items))))
            return items
        if isinstance(event, MappingStartEvent):
            return self._mapping(events, path)
        return self._scalar(event, path)

    def _mapping(self, events: Iterator[Any], path: Steps) -> dict[str, tuple[Node, Node]]:
        entries, before = dict[str, tuple[Node, Node]](), None  # and the event of the last value
        while not isinstance(event := next(events), MappingEndEvent):
            key = self._node(event, events, (*path, "?"))
            name = key.value if isinstance(key.value, str) else str(getattr(event, "value", "?"))
            if decimal := decimal_comma(before, event):
                self._note(f"this comma separates two keys; write a decimal point: {decimal}", event, path)
            elif not isinstance(key.value, str):
                written = f'; write "{shorten(name, 30)}" in quotes' if isinstance(event, ScalarEvent) else ""
                self._note(f"a key is a text, found {self._named(key, event)}{written}", event, path)
            elif name == "<<" and getattr(event, "style", None) is None:
                self._note("merge keys (<<) are not part of YAML 1.2; write the keys out", event, path)
            before = next(events)
            value = self._node(before, events, (*path, name))
            if name in entries:
                first = entries[name][0]
                self._note(
                    f"{'.'.join(map(str, (*path, shorten(name))))} appears twice, first at "
                    f"{self.name}:{first.line}:{first.column}; keep one of them",
                    event,
                    (*path, name),
                )
            else:
                entries[name] = (key, value)
        return entries

    def _named(self, key: Node, event: Any) -> str:
        return f"the value {shorten(event.value, 30)}" if isinstance(event, ScalarEvent) else _kind(key.value)

    def _scalar(self, event: Any, path: Steps) -> Scalar:
        text: str = event.value
        if strange := UNPRINTABLE.search(
            text
        ):  # from an escape, "\\e" or "\\ud800"; such a character is not allowed in the text itself
            self._note(unreadable(strange.group()), event, path)
            return UNPRINTABLE.sub("", text)
        if event.style is not None:
            return text
        number = plain_scalar(text)
        if not isinstance(number, float):
            return number
        if not math.isfinite(number):
            where = ".".join(map(str, path))
            found = f"{where}: expected a finite number, found {shorten(text, 30)}"
            self.faults.append(ValueFault(found, path=path, location=self._at(event)))
        return number

    def _alias(self, event: Any, path: Steps) -> Node:
        name = str(event.anchor)
        node = self._anchors.get(name)
        if node is not None:
            return node
        if name in self._anchors:
            raise self._fault(f"the alias *{name} is inside the value that it repeats; write it out", event, path)
        self._note(f"the alias *{name} repeats no anchor; {nearest(name, self._anchors)}", event, path)
        return Node(event.start_mark.line + 1, event.start_mark.column + 1, None)

    def _size(self, value: object, event: Any, path: Steps) -> int:
        inner: list[Node] = []
        if isinstance(value, list):
            inner = value
        elif isinstance(value, dict):
            inner = [node for pair in value.values() for node in pair]
        size = 1 + sum(node.size for node in inner)
        self._bound(size, event, path)
        return size

    def _bound(self, count: int, event: Any, path: Steps) -> None:
        if count > MOST_NODES:
            raise self._fault(
                f"more than {MOST_NODES} values, aliases written out; shorten the {self.noun}", event, path
            )

    def _at(self, event: Any) -> str:
        return f"{self.name}:{event.start_mark.line + 1}:{event.start_mark.column + 1}"

    def _fault(self, text: str, event: Any, path: Steps = ()) -> DocumentError:
        return DocumentError(text, path=path, location=self._at(event))

    def _note(self, text: str, event: Any, path: Steps = ()) -> None:
        self.faults.append(self._fault(text, event, path))
