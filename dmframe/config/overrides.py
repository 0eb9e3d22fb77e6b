"""Overrides of values in a graph file: ``--set task.gamma=2``, or ``graph.set({"task.gamma": 2})``.

They are set in the document itself, so that every later reader, former names included, uses one text.
Each node records the override that set it, so that a fault in it can name the override.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from dmframe.common.errors import DmframeError, UnknownNameError, ValueFault, visible
from dmframe.common.units import shorten
from dmframe.config.document import Document, Node, mapping_of, read_document
from dmframe.config.given import node_of

LABELLED: Final = (("start",), ("uncertain",), ("wires",), ("robot", "hold"))
"""Sections whose keys may contain dots, such as ``servo.K_D``: the text after the section's name is one key."""
NAMED: Final = {"robot": "model", "reality": "like"}
"""Sections that may be given as a name only, and the key of that name."""
_INNER = re.compile(r", first at :\d+:\d+")
"""Place within the text of an override, in a parser message; it belongs to no file of the user."""
_COMMENT = re.compile(r"(?:^|\s)#")


def overridden(document: Document, overrides: Sequence[str], known: Sequence[str]) -> Document:
    """The document with ``--set`` values; `known` are the keys of a graph."""
    for text in overrides:
        origin = f"--set {shorten(visible(text), 200)}"
        document = put_at(document, text.partition("=")[0], _value(text, origin), origin, known, equals="=" in text)
    return document


def changed(document: Document, values: Mapping[str, Any], known: Sequence[str]) -> Document:
    """The document with values given by a program."""
    for label, node, _, origin in _given(values):
        document = put_at(document, label, node, origin, known)
    return document


def texts_of(values: Mapping[str, Any]) -> tuple[str, ...]:
    """Values given by a program, each as an argument of ``--set``."""
    return tuple(text for _, _, text, _ in _given(values))


def _given(values: Mapping[str, Any]) -> Iterator[tuple[str, Node, str, str]]:
    """Labels with their values, each as an argument of ``--set``, and its name in messages."""
    for label, value in values.items():
        if isinstance(label, str) and "=" in label:
            raise ValueFault(f"set {shorten(visible(label), 60)}: expected a name alone, without an equals sign")
        if not isinstance(label, str):
            raise ValueFault(f"set: expected a text such as 'task.gamma' as the name, found {shorten(repr(label), 30)}")
        origin = f"set {shorten(visible(label), 60)}"
        node = node_of(value, (label,), origin)
        text = f"{label}={json.dumps(mapping_of(Node(0, 0, {'value': (node, node)}))['value'])}"
        origin = f"set {shorten(visible(text), 200)}"
        yield label, node, text, origin


def put_at(
    document: Document, label: str, value: Node, origin: str, known: Sequence[str], *, equals: bool = True
) -> Document:
    """The document with a value under a label such as ``dynamics.Gamma``; messages call its place `origin`.

    The label of a whole block is its name, ``blocks.inverse``; an empty value removes it.
    """
    held = value.value
    whole = held is None or (isinstance(held, dict) and "type" in held)
    keys = _target(label, origin, document.data, known, whole=whole, equals=equals)
    if len(keys) == 2 and keys[0] == "blocks" and held is None:
        root = _without(document.root, keys[1], origin)
    else:
        root = _put(document.root, keys, _by(value, origin), origin)
    return document.with_root(root)


def put(document: Document, key: str, value: float, origin: str) -> Document:
    """The document with another number under one of its keys; messages call its place `origin`."""
    root = _put(document.root, [key], Node(1, 1, value, origin=origin), origin)
    return Document(document.name, {**document.data, key: value}, root)


def _target(
    label: str, origin: str, data: Mapping[str, Any], known: Sequence[str], *, whole: bool, equals: bool
) -> list[str]:
    """The keys of the value that an override sets, or of a `whole` block. A block may be preceded by ``blocks.``."""
    keys, blocks = label.strip().split("."), data.get("blocks")
    inside = blocks if isinstance(blocks, dict) else {}
    names = list(inside)
    if not equals or not all(keys):
        raise ValueFault(f"{origin}: expected block.parameter=value or key=value")
    if keys[0] in names:
        keys = ["blocks", *keys]
    if keys[0] not in known:
        holders = [f"{name}.{keys[0]}" for name, own in inside.items() if isinstance(own, dict) and keys[0] in own]
        raise UnknownNameError(origin, "block or key", keys[0], holders or [*names, *known])
    if keys[0] == "blocks" and len(keys) > 2 and keys[1] not in names:
        raise UnknownNameError(origin, "block", keys[1], names)
    if keys[0] == "blocks" and len(keys) == 2 and whole:
        return keys
    if keys[0] == "blocks" and len(keys) < 3:
        raise ValueFault(f"{origin}: expected a parameter of a block, {(*keys, 'block')[1]}.parameter=value")
    for section in LABELLED:
        if tuple(keys[: len(section)]) == section and len(keys) > len(section):
            return [*section, ".".join(keys[len(section) :])]
    return keys


def _without(root: Node, name: str, origin: str) -> Node:
    """The graph's mapping without one of its blocks."""
    entries = dict(root.value) if isinstance(root.value, dict) else {}
    key, blocks = entries["blocks"]
    kept = dict(blocks.value) if isinstance(blocks.value, dict) else {}
    if kept.pop(name, None) is None:
        raise UnknownNameError(origin, "block", name, kept)
    return replace(root, value={**entries, "blocks": (key, replace(blocks, value=kept))})


def _value(text: str, origin: str) -> Node:
    """The value after the equals sign, as in YAML, without a comment."""
    written = text.partition("=")[2].strip()
    value = _read(written, origin)
    for mark in _COMMENT.finditer(written):
        try:
            before = _read(written[: mark.start()], origin)
        except DmframeError:
            continue  # this one is in quotes or in a list
        if mapping_of(before) == mapping_of(value):
            raise ValueFault(f"{origin}: a # begins a comment here; put a text that holds one in double quotes")
    return _by(_only(value, origin), origin)


def _read(written: str, origin: str) -> Node:
    try:
        return read_document(f"value: {written}\n", "").root
    except DmframeError as error:
        reason = error.faults[0].text
        reason = _INNER.sub("", reason.removeprefix("value: ").removeprefix("value."))
        raise ValueFault(f"{origin}: {reason}") from None


def _only(root: Node, origin: str) -> Node:
    entries = root.value if isinstance(root.value, dict) else {}
    for name in entries:
        if name != "value":
            raise ValueFault(f"{origin}: expected one value, found {shorten(name)} too; use a separate --set for it")
    return entries["value"][1]


def _by(node: Node, origin: str) -> Node:
    """The node and all below it, marked as set by an override."""
    value = node.value
    if isinstance(value, dict):
        value = {name: (_by(key, origin), _by(below, origin)) for name, (key, below) in value.items()}
    elif isinstance(value, list):
        value = [_by(item, origin) for item in value]
    return replace(node, value=value, origin=origin)


def _put(node: Node, keys: Sequence[str], value: Node, origin: str) -> Node:
    """The mapping with a value at `keys`; missing mappings in between are created."""
    entries = dict(node.value) if isinstance(node.value, dict) else {}
    first, *rest = keys
    key, held = entries.get(first, (Node(1, 1, first, origin=origin), Node(1, 1, None, origin=origin)))
    if not rest:
        entries[first] = (replace(key, origin=origin), value)
        return replace(node, value=entries)
    if first in NAMED and isinstance(held.value, str):  # the section is a name only
        held = replace(held, value={NAMED[first]: (held, held)})
    if held.value is not None and not isinstance(held.value, dict):
        raise ValueFault(f"{origin}: {first} has no keys")
    entries[first] = (key, _put(held, rest, value, origin))
    return replace(node, value=entries)
