"""Overrides of values in a graph file: ``--set task.gamma=2``, or ``graph.set({"task.gamma": 2})``.

They are set in the document itself, so that everything that reads it later, former names included, reads one text.
Each node records the override that set it, so that a fault in it can name the override.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from dmframe.config.document import Document, Node, mapping_of, read_document
from dmframe.config.given import node_of
from dmframe.errors import DmframeError, UnknownNameError, ValueFault, visible
from dmframe.units import shorten

LABELLED: Final = (("start",), ("uncertain",), ("wires",), ("robot", "hold"))
"""Sections whose keys may contain dots, such as ``servo.K_D``: the text after the section's name is one key."""
NAMED: Final = {"robot": "model", "reality": "like"}
"""Sections that may be given as a name alone, and the key for which the name stands."""
_INNER = re.compile(r", first at :\d+:\d+")
"""A place in the line that the parser reads for an override; it is in no file of the user's."""
_COMMENT = re.compile(r"(?:^|\s)#")


def overridden(document: Document, overrides: Sequence[str], known: Sequence[str]) -> Document:
    """The document with ``--set`` values; `known` are the keys of a graph."""
    for text in overrides:
        said = f"--set {shorten(visible(text), 200)}"
        document = put_at(document, text.partition("=")[0], _value(text, said), said, known, equals="=" in text)
    return document


def changed(document: Document, values: Mapping[str, Any], known: Sequence[str]) -> Document:
    """The document with values given by a program."""
    for label, node, _, said in _given(values):
        document = put_at(document, label, node, said, known)
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
        said = f"set {shorten(visible(label), 60)}"
        node = node_of(value, (label,), said)
        text = f"{label}={json.dumps(mapping_of(Node(0, 0, {'value': (node, node)}))['value'])}"
        said = f"set {shorten(visible(text), 200)}"
        yield label, node, text, said


def put_at(
    document: Document, label: str, value: Node, said: str, known: Sequence[str], *, equals: bool = True
) -> Document:
    """The document with a value under a label such as ``dynamics.Gamma``; messages call its place `said`.

    The label of a whole block is its name, ``blocks.inverse``; an empty value removes it.
    """
    held = value.value
    whole = held is None or (isinstance(held, dict) and "type" in held)
    keys = _target(label, said, document.data, known, whole=whole, equals=equals)
    if len(keys) == 2 and keys[0] == "blocks" and held is None:
        root = _without(document.root, keys[1], said)
    else:
        root = _put(document.root, keys, _by(value, said), said)
    return document.with_root(root)


def put(document: Document, key: str, value: float, said: str) -> Document:
    """The document with another number under one of its keys; messages call its place `said`."""
    root = _put(document.root, [key], Node(1, 1, value, said=said), said)
    return Document(document.name, {**document.data, key: value}, root)


def _target(
    label: str, said: str, data: Mapping[str, Any], known: Sequence[str], *, whole: bool, equals: bool
) -> list[str]:
    """The keys of the value that an override sets, or of a `whole` block. A block may be preceded by ``blocks.``."""
    keys, blocks = label.strip().split("."), data.get("blocks")
    names = list(blocks) if isinstance(blocks, dict) else []
    if not equals or not all(keys):
        raise ValueFault(f"{said}: expected block.parameter=value or key=value")
    if keys[0] in names:
        keys = ["blocks", *keys]
    if keys[0] not in known:
        raise UnknownNameError(said, "block or key", keys[0], [*names, *known])
    if keys[0] == "blocks" and len(keys) > 2 and keys[1] not in names:
        raise UnknownNameError(said, "block", keys[1], names)
    if keys[0] == "blocks" and len(keys) == 2 and whole:
        return keys
    if keys[0] == "blocks" and len(keys) < 3:
        raise ValueFault(f"{said}: expected a parameter of a block, {(*keys, 'block')[1]}.parameter=value")
    for section in LABELLED:
        if tuple(keys[: len(section)]) == section and len(keys) > len(section):
            return [*section, ".".join(keys[len(section) :])]
    return keys


def _without(root: Node, name: str, said: str) -> Node:
    """The graph's mapping without one of its blocks."""
    entries = dict(root.value) if isinstance(root.value, dict) else {}
    key, blocks = entries["blocks"]
    kept = dict(blocks.value) if isinstance(blocks.value, dict) else {}
    if kept.pop(name, None) is None:
        raise UnknownNameError(said, "block", name, kept)
    return replace(root, value={**entries, "blocks": (key, replace(blocks, value=kept))})


def _value(text: str, said: str) -> Node:
    """The value after the equals sign, as in YAML, without a comment."""
    written = text.partition("=")[2].strip()
    value = _read(written, said)
    for mark in _COMMENT.finditer(written):
        try:
            before = _read(written[: mark.start()], said)
        except DmframeError:
            continue  # this one is in quotes or in a list
        if mapping_of(before) == mapping_of(value):
            raise ValueFault(f"{said}: a # begins a comment here; put a text that holds one in double quotes")
    return _by(_only(value, said), said)


def _read(written: str, said: str) -> Node:
    try:
        return read_document(f"value: {written}\n", "").root
    except DmframeError as error:
        reason = error.faults[0].text
        reason = _INNER.sub("", reason.removeprefix("value: ").removeprefix("value."))
        raise ValueFault(f"{said}: {reason}") from None


def _only(root: Node, said: str) -> Node:
    entries = root.value if isinstance(root.value, dict) else {}
    for name in entries:
        if name != "value":
            raise ValueFault(f"{said}: expected one value, found {shorten(name)} too; use a separate --set for it")
    return entries["value"][1]


def _by(node: Node, said: str) -> Node:
    """The node and all below it, marked as set by an override."""
    value = node.value
    if isinstance(value, dict):
        value = {name: (_by(key, said), _by(below, said)) for name, (key, below) in value.items()}
    elif isinstance(value, list):
        value = [_by(item, said) for item in value]
    return replace(node, value=value, said=said)


def _put(node: Node, keys: Sequence[str], value: Node, said: str) -> Node:
    """The mapping with a value at `keys`; missing mappings in between are created."""
    entries = dict(node.value) if isinstance(node.value, dict) else {}
    first, *rest = keys
    key, held = entries.get(first, (Node(1, 1, first, said=said), Node(1, 1, None, said=said)))
    if not rest:
        entries[first] = (replace(key, said=said), value)
        return replace(node, value=entries)
    if first in NAMED and isinstance(held.value, str):  # the section is a name alone
        held = replace(held, value={NAMED[first]: (held, held)})
    if held.value is not None and not isinstance(held.value, dict):
        raise ValueFault(f"{said}: {first} has no keys")
    entries[first] = (key, _put(held, rest, value, said))
    return replace(node, value=entries)
