"""Values given by a program: converted into the same nodes as a file's text, and lists of values by name."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from numbers import Number
from typing import Any

import numpy as np

from dmframe.common.errors import DocumentError, ValueFault
from dmframe.common.units import shorten
from dmframe.config.document import (
    DEEPEST,
    MOST_BYTES,
    MOST_NODES,
    UNPRINTABLE,
    Document,
    Node,
    Steps,
    mapping_of,
    unreadable,
)


def document_of(data: Mapping[Any, Any], name: str) -> Document:
    """A graph given as data, which may contain NumPy arrays and numbers; `name` is its name in messages.

    Raises `DocumentError` for a value that no graph file can contain, and `ValueFault` for a number that is not finite.
    """
    root = node_of(data, ())
    if not isinstance(root.value, dict) or not root.value:
        raise DocumentError("expected a graph, found no keys; a graph begins with dmframe: 1", location=name)
    return Document(name, mapping_of(root), root)


def node_of(value: Any, path: Steps, origin: str = "") -> Node:
    """The node of a value given by a program.

    Raises `DocumentError` for a value that no file can contain, and `ValueFault` for a number that is not finite.
    """
    where = ".".join(map(str, path)) or "graph"
    if len(path) > DEEPEST:
        raise DocumentError(f"nested deeper than {DEEPEST} levels; a graph needs about four", location=origin)
    if isinstance(value, np.ndarray | np.generic | range) or hasattr(value, "__array__"):  # pandas and xarray too
        array = np.asarray(value)
        if array.dtype.kind in "mM":
            raise DocumentError(f"{where}: expected numbers, found dates or spans of time", location=origin)
        if array.size > MOST_NODES:
            raise DocumentError(f"{where}: expected at most {MOST_NODES} numbers, found {array.size}", location=origin)
        value = array.tolist()
    if isinstance(value, Number) and not isinstance(value, int | float | complex):  # a Fraction, a Decimal
        value = float(value)  # type: ignore[arg-type]  # Number does not declare __float__
    if isinstance(value, Mapping):
        entries = dict[str, tuple[Node, Node]]()
        for key, item in value.items():
            if not isinstance(key, str):
                raise DocumentError(f"{where}: a key is a text, found {shorten(repr(key), 30)}", location=origin)
            _check_letters(key, where, origin)
            entries[key] = (Node(0, 0, key, origin=origin), node_of(item, (*path, key), origin))
        return Node(0, 0, entries, 1 + sum(node.size for _, node in entries.values()), origin)
    if isinstance(value, list | tuple):
        if len(value) > MOST_NODES:
            raise DocumentError(f"{where}: expected at most {MOST_NODES} values, found {len(value)}", location=origin)
        items = [node_of(item, (*path, place), origin) for place, item in enumerate(value)]
        return Node(0, 0, items, 1 + sum(node.size for node in items), origin)
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueFault(f"{where}: expected a finite number, found {value}", path=path, location=origin)
    if isinstance(value, os.PathLike):
        value = os.fsdecode(value)
    if isinstance(value, str):
        _check_letters(value, where, origin)
    if isinstance(value, int) and abs(value) > 10**400:
        raise ValueFault(
            f"{where}: expected a finite number, found one of hundreds of digits", path=path, location=origin
        )
    if value is None or isinstance(value, str | int | float):
        return Node(0, 0, value, origin=origin)
    raise DocumentError(
        f"{where}: expected a number, a text, a list or keys with values, found {type(value).__name__}", location=origin
    )


def listed(values: Mapping[str, Iterable[Any]]) -> dict[str, list[Any]]:
    """Lists of values by name. Raises `ValueFault` for anything else."""
    example = '{"dynamics.Gamma": [1, 10]}'
    if not isinstance(values, Mapping):
        raise ValueFault(f"values: expected values by name, {example}, found {shorten(repr(values), 30)}")
    tried = dict[str, list[Any]]()
    for label, several in values.items():
        if not isinstance(label, str):
            raise ValueFault(f"values: expected values by name, {example}, found {shorten(repr(label), 30)}")
        some = isinstance(several, Iterable) and getattr(several, "ndim", 1) > 0  # an array may hold one number
        if isinstance(several, str | bytes | Mapping) or not some:
            raise ValueFault(
                f"values {label}: expected a list of values, {example}, found {shorten(repr(several), 30)}"
            )
        tried[label] = list(several)
    for label, several in tried.items():
        if not several:
            raise ValueFault(f"values {label}: expected at least one value, found none")
    return tried


def _check_letters(text: str, where: str, origin: str) -> None:
    if len(text) > MOST_BYTES:
        raise DocumentError(f"{where}: expected a short text, found one of {len(text)} letters", location=origin)
    if strange := UNPRINTABLE.search(text):
        raise DocumentError(f"{where}: {unreadable(strange.group())}", location=origin)
