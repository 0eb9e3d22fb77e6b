"""Data classes that hold untyped expressions of block authors: type check of their fields, and their expressions."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from functools import cache
from types import UnionType
from typing import Any, Final, Self, get_args, get_origin, get_type_hints

import casadi as ca
import numpy as np

EXPRESSIONS: Final = (ca.SX, ca.MX, ca.DM, int, float, np.number)
"""Types that an expression may have; annotations call it `SX`, an `Any`."""


def check_fields(stated: Any) -> None:
    """Raise `TypeError` if a field of a dataclass does not match its annotation."""
    for name, kind in _kinds(stated.__class__).items():
        if not _fits(kind, value := getattr(stated, name)):
            raise TypeError(f"{type(stated).__name__}: {fault_of(name, kind, value)}")


class Expressions:
    """Base of data classes whose fields annotated `SX`, or tuples of these, hold expressions."""

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def pieces(self) -> tuple[Any, ...]:
        """Its expressions, field by field."""
        own: Any = type(self)
        return tuple(pieces_of([getattr(self, name) for name in _expression_fields(own)]))

    def with_pieces(self, pieces: Sequence[Any]) -> Self:
        """The same object with other expressions."""
        own, left = type(self), iter(pieces)  # type: Any, Iterator[Any]
        changed: Any = {name: refilled(getattr(self, name), left) for name in _expression_fields(own)}
        return replace(self, **changed)  # type: ignore[type-var]  # each subclass is a data class


def pieces_of(value: Any) -> Iterator[Any]:
    """The expressions of a value: an expression, `Expressions`, a sequence or mapping of these, or None."""
    if isinstance(value, Expressions):
        yield from value.pieces
    elif isinstance(value, tuple | list):
        yield from (piece for item in value for piece in pieces_of(item))
    elif isinstance(value, Mapping):
        yield from pieces_of(list(value.values()))
    elif value is not None:
        yield value


def refilled(value: Any, pieces: Iterator[Any]) -> Any:
    """The same value with other expressions, taken in the order of `pieces_of`."""
    if isinstance(value, Expressions):
        return value.with_pieces([next(pieces) for _ in value.pieces])
    if isinstance(value, tuple | list):
        return tuple(refilled(item, pieces) for item in value)
    if isinstance(value, Mapping):
        return {name: refilled(item, pieces) for name, item in value.items()}
    return None if value is None else next(pieces)


@cache
def _expression_fields(of: type) -> tuple[str, ...]:
    """The fields that hold expressions."""
    return tuple(name for name, kind in _kinds(of).items() if _has_expressions(kind))


def _has_expressions(kind: Any) -> bool:
    return kind is Any or (get_origin(kind) is tuple and _has_expressions(get_args(kind)[0]))


@cache
def _kinds(of: Any) -> dict[str, Any]:
    kinds = get_type_hints(of)
    return {item.name: kinds[item.name] for item in fields(of)}


def fault_of(name: str, kind: Any, value: Any) -> str:
    """Type error of a value, for its innermost part; empty if there is none."""
    origin, parts = _parts(kind)
    if origin is tuple and type(value) is tuple:
        found = (fault_of(f"{name}[{place}]", parts[0], item) for place, item in enumerate(value))
    elif origin is Mapping and isinstance(value, Mapping):
        keys = (fault_of(f"each name of {name}", parts[0], key) for key in value)
        found = (fault for faults in (keys, _values(name, parts[1], value)) for fault in faults)
    elif _is(kind, value):
        return ""
    else:
        comma = "; is a comma missing?" if origin is tuple and not fault_of(name, parts[0], value) else ""
        return f"expected {name} to be {_words(kind)}, found {_found(value)}{comma}"
    return next(filter(None, found), "")


def _values(name: str, kind: Any, value: Mapping[Any, Any]) -> Any:
    return (fault_of(f"{name}[{key!r}]", kind, item) for key, item in value.items())


@cache
def _parts(kind: Any) -> tuple[Any, tuple[Any, ...]]:
    return get_origin(kind), get_args(kind)


def _fits(kind: Any, value: Any) -> bool:
    """True if `fault_of` would report no fault; faster, since no text is made."""
    origin, parts = _parts(kind)
    if origin is tuple and type(value) is tuple:
        return all(_fits(parts[0], item) for item in value)
    if origin is Mapping and isinstance(value, Mapping):
        return all(_fits(parts[0], key) and _fits(parts[1], item) for key, item in value.items())
    return _is(kind, value)


def _is(kind: Any, value: Any) -> bool:
    """True for a value of exactly that type; an instance of an author's subclass could have another meaning."""
    if kind is Any:
        numbers = isinstance(value, np.ndarray) and value.ndim <= 2 and value.dtype.kind in "iuf"
        return numbers or (isinstance(value, EXPRESSIONS) and not isinstance(value, bool))
    if isinstance(kind, UnionType):
        return any(_is(part, value) for part in _parts(kind)[1])
    if not isinstance(kind, type):
        return False
    sealed = getattr(kind, "__final__", False) or kind in (str, int)
    return type(value) is kind if sealed else isinstance(value, kind)


def _words(kind: Any) -> str:
    origin, parts = get_origin(kind), get_args(kind)
    if origin is tuple:
        return f"a tuple of {_many(parts[0])}"
    if origin is Mapping:
        return f"a mapping of names to {_many(parts[1])}"
    if isinstance(kind, UnionType):
        *first, last = map(_words, parts)
        return f"{', '.join(first)} or {last}"
    return _KNOWN[kind][0] if kind in _KNOWN else _article(kind.__name__)


_KNOWN: Final = {
    Any: ("an expression", "expressions"),
    str: ("a text", "texts"),
    bool: ("True or False", ""),
    type(None): ("None", ""),
}


def _many(kind: Any) -> str:
    if get_origin(kind) is tuple:
        return f"tuples of {_many(get_args(kind)[0])}"
    return _KNOWN[kind][1] if kind in _KNOWN else re.sub(r"\ban? ", "", _words(kind))


def _found(value: Any) -> str:
    return "None" if value is None else _article(type(value).__name__)


def _article(name: str) -> str:
    return f"{'an' if name[0] in 'aeioAEIO' or name in ('SX', 'MX', 'ndarray') else 'a'} {name}"
