"""A claim as JSON, and back: the written object is the checked one.

    {"version": 1, "symbols": [...], "gains": [...], "operator": "flow", "moves": {...}, "parts": [...], ...,
     "program": {"inputs": [[name, rows, size]], "outputs": [[name, rows, size, places, nodes]],
                 "nodes": [["add", 3, 4], ["input", 0, 2], ["const", "1/10"], ...]}}

Numbers are exact fractions: a decimal is written as the fraction it represents.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields
from fractions import Fraction
from functools import partial
from hashlib import sha256
from types import UnionType
from typing import Any, Final, Literal, get_args, get_origin, get_type_hints

from dmframe.common.errors import ValueFault
from dmframe.exact.literal import exact
from dmframe.program import BY_NAME, CONST, INPUT, OPERATIONS, Node, Pattern, Program
from dmframe.prove.claim import Claim
from dmframe.prove.signs import Numbers
from dmframe.prove.sound import require_sound

VERSION: Final = 1

NUMBER: Final = re.compile(r"-?[0-9]{1,4000}(/[0-9]{1,4000})?")
"""An exact number; exponents are excluded, since a few characters could then represent a huge number."""


def digest(claim: Claim) -> str:
    """Hash of the complete claim."""
    return sha256(to_json(claim).encode()).hexdigest()


def to_json(claim: Claim, numbers: Numbers | None = None) -> str:
    """A claim as compact JSON with sorted keys, and the parameter values at which signs are decided."""
    own = {item.name: _plain(getattr(claim, item.name)) for item in fields(claim) if item.name != "program"}
    if numbers is not None:
        own["numbers"] = {label: [str(value) for value in values] for label, values in numbers.items()}
    return json.dumps(
        {"version": VERSION, **own, "program": _of_program(claim.program)}, sort_keys=True, separators=(",", ":")
    )


def _plain(value: Any) -> Any:
    """Tuples as lists, fractions as strings, data classes as their fields."""
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, Fraction):
        return str(value)
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return {item.name: _plain(getattr(value, item.name)) for item in fields(value)}


def _of_program(program: Program) -> dict[str, Any]:
    return {
        "inputs": [[item.name, item.rows, item.size] for item in program.inputs],
        "outputs": [
            [item.name, item.rows, item.size, list(item.places), list(sources)]
            for item, sources in zip(program.outputs, program.sources, strict=True)
        ],
        "nodes": list(_nodes(program.nodes)),
    }


def _nodes(nodes: Sequence[Node]) -> Iterator[list[Any]]:
    names = {code: operation.name for code, operation in OPERATIONS.items()}
    two = {code for code, operation in OPERATIONS.items() if operation.arity == 2}
    for code, a, b, constant, _ in nodes:
        if code == CONST:
            yield ["const", str(exact(constant))]
        elif code == INPUT:
            yield ["input", a, b]
        elif code in names:
            yield [names[code], a, b] if code in two else [names[code], a]
        else:
            raise ValueFault(f"expected scalar operations, found CasADi's instruction {code}")


def from_json(text: str) -> Claim:
    """Read a claim; raises `ValueFault` for another version and for an invalid claim (`require_sound`)."""
    return read_file(text)[0]


def read_file(text: str) -> tuple[Claim, Numbers]:
    """Read a claim and the values of its parameters; raises like `from_json`, and for values of unknown parameters."""
    try:
        found = json.loads(text, object_pairs_hook=_unique_keys)
        if not isinstance(found, dict) or found["version"] is True or found["version"] != VERSION:
            given = found["version"] if isinstance(found, dict) else found
            raise ValueFault(f"a claim: expected version {VERSION}, found {given!r:.60}")
        del found["version"]
        numbers: Numbers = _read(Mapping[str, tuple[Fraction, ...]], found.pop("numbers", {}))
        claim: Claim = _read(Claim, found)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, ZeroDivisionError, RecursionError) as error:
        text = f"found {type(error).__name__}: {error}"
        raise ValueFault(f"a claim: expected the format of `to_json`, {text:.300}") from None
    require_sound(claim)
    sizes = {symbol.label: symbol.size for symbol in claim.symbols if symbol.kind == "parameter"}
    for label, values in numbers.items():
        if sizes.get(label) != len(values):
            raise ValueFault(
                f"a claim: expected numbers of its parameters, with as many values as elements, found {label}"
            )
    return claim, numbers


def _unique_keys(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError(f"a repeated key among {sorted(key for key, _ in pairs)}")
    return found


def _with(kind: type, item: Any) -> dict[str, Any]:
    """A JSON object with exactly the fields of a data class."""
    expected = {each.name for each in fields(kind)}
    if not isinstance(item, dict):
        raise TypeError(f"expected a {kind.__name__}, found {item!r:.60}")
    if wrong := sorted(item.keys() ^ expected):
        raise ValueError(f"{', '.join(wrong)}: missing or unknown key of a {kind.__name__}")
    return item


def _text(item: Any) -> str:
    if not isinstance(item, str):
        raise TypeError(f"expected a text, found {item!r:.60}")
    return item


def _integer(item: Any) -> int:
    if type(item) is not int or item < 0:
        raise ValueError(f"expected a whole number, at least 0, found {item!r:.60}")
    return item


def _number(item: Any) -> Fraction:
    if not NUMBER.fullmatch(_text(item)):
        raise ValueError(f"expected a whole number or a fraction, found {item}")
    return Fraction(item)


def _list(item: Any, read: Callable[[Any], Any]) -> tuple[Any, ...]:
    if not isinstance(item, list):
        raise TypeError(f"expected a list, found {item!r:.60}")
    return tuple(map(read, item))


def _read(kind: Any, item: Any) -> Any:
    """Value of an annotated type from JSON; raises `TypeError` or `ValueError` for any other content."""
    origin, parts = get_origin(kind), get_args(kind)
    if kind in _SCALARS:
        return _SCALARS[kind](item)
    if hasattr(kind, "__dataclass_fields__"):
        given, kinds = _with(kind, item), get_type_hints(kind)
        return kind(**{name: _read(kinds[name], value) for name, value in given.items()})
    if origin is UnionType:
        return None if item is None else _read(parts[0], item)
    if origin is Literal:
        if item not in parts:
            raise ValueError(f"expected one of {', '.join(parts)}, found {item!r:.60}")
        return item
    if origin is tuple and parts[-1] is ...:
        return _list(item, partial(_read, parts[0]))
    if origin is tuple:
        found = _list(item, _text)
        if len(found) != len(parts):
            raise ValueError(f"expected {len(parts)} texts, found {len(found)}")
        return found
    if not isinstance(item, dict):
        raise TypeError(f"expected an object, found {item!r:.60}")
    return {label: _read(parts[1], value) for label, value in item.items()}


def _program(item: Any) -> Program:
    if not isinstance(item, dict) or item.keys() != {"inputs", "nodes", "outputs"}:
        raise ValueError(f"expected the inputs, nodes and outputs of a program, found {item!r:.60}")
    inputs = _list(item["inputs"], _input)
    nodes = [_node(place, node, inputs) for place, node in enumerate(_list(item["nodes"], list))]
    outputs, sources = list[Pattern](), list[Sequence[int]]()
    for name, rows, size, given, places in _list(item["outputs"], list):
        own = _list(places, _integer)
        outputs.append(Pattern(_text(name), _integer(rows), _integer(size), _list(given, _integer)))
        sources.append(own)
        if len(outputs[-1].places) != len(own) or not all(k < len(nodes) for k in own) or size % max(rows, 1):
            raise ValueError(f"the output {name}")
    return Program("claim", nodes, inputs, outputs, sources)


def _input(item: Any) -> Pattern:
    name, rows, size = _list(item, lambda each: each)
    return Pattern(_text(name), _integer(rows), _integer(size), range(size))


def _node(place: int, node: Sequence[Any], inputs: Sequence[Pattern]) -> Node:
    name, *given = node
    if name == "const":
        (number,) = given
        return Node(CONST, 0, 0, _number(number), place)  # type: ignore[arg-type]  # `exact` keeps a fraction
    a, b = _integer(given[0]), _integer(given[-1])
    if name == "input":
        if len(given) != 2 or b >= inputs[a].size:
            raise ValueError(f"element {b} of the input {inputs[a].name}, which has {inputs[a].size}")
        return Node(INPUT, a, b, 0.0, place)
    operation = BY_NAME[_text(name)]
    if len(given) != operation.arity or max(a, b) >= place:
        raise ValueError(f"the instruction {place}, {name} of {given}")
    return Node(operation.code, a, b, 0.0, place)


def _flag(item: Any) -> bool:
    if not isinstance(item, bool):
        raise TypeError(f"expected true or false, found {item!r:.60}")
    return item


_SCALARS: Final[Mapping[Any, Callable[[Any], Any]]] = {
    str: _text,
    int: _integer,
    bool: _flag,
    Fraction: _number,
    Program: _program,
}
