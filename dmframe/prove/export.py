"""A claim as JSON, and back: what is written is the object that was checked.

    {"version": 1, "symbols": [...], "gains": [...], "operator": "flow", "moves": {...}, "parts": [...], ...,
     "program": {"inputs": [[name, rows, size]], "outputs": [[name, rows, size, places, nodes]],
                 "nodes": [["add", 3, 4], ["input", 0, 2], ["const", "1/10"], ...]}}

Numbers are exact: decimals as they were written, as fractions.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields
from fractions import Fraction
from hashlib import sha256
from typing import Any, Final

from dmframe.errors import ValueFault
from dmframe.exact.literal import exact
from dmframe.program import BY_NAME, CONST, INPUT, OPERATIONS, Node, Pattern, Program
from dmframe.prove.claim import Claim, Line, Part, Relation, Steps, Symbol, Term
from dmframe.prove.sound import hold_sound

VERSION: Final = 1

NUMBER: Final = re.compile(r"-?[0-9]{1,4000}(/[0-9]{1,4000})?")
"""An exact number; an exponent would write one of any size in a few characters."""


def digest(claim: Claim) -> str:
    """A hash of all that a claim holds."""
    return sha256(to_json(claim).encode()).hexdigest()


def to_json(claim: Claim) -> str:
    """A claim as JSON, with sorted keys and no spaces."""
    own = {item.name: _plain(getattr(claim, item.name)) for item in fields(claim) if item.name != "program"}
    return json.dumps(
        {"version": VERSION, **own, "program": _of_program(claim.program)}, sort_keys=True, separators=(",", ":")
    )


def _plain(value: Any) -> Any:
    """Tuples as lists, fractions as texts, data classes as their fields."""
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
        else:
            yield [names[code], a, b] if code in two else [names[code], a]


def from_json(text: str) -> Claim:
    """The claim that a file holds; raises `ValueFault` for another version and for what is no claim (`hold_sound`)."""
    try:
        found = json.loads(text, object_pairs_hook=_once)
        if not isinstance(found, dict) or found["version"] is True or found["version"] != VERSION:
            given = found["version"] if isinstance(found, dict) else found
            raise ValueFault(f"a claim: expected version {VERSION}, found {given!r:.60}")
        del found["version"]
        claim = _claim(_with(Claim, found))
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, ZeroDivisionError, RecursionError) as error:
        text = f"found {type(error).__name__}: {error}"
        raise ValueFault(f"a claim: expected what `to_json` writes, {text:.300}") from None
    hold_sound(claim)
    return claim


def _once(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError(f"a key twice among {sorted(key for key, _ in pairs)}")
    return found


def _with(kind: type, item: Any) -> dict[str, Any]:
    """An object of JSON with the fields of a data class, and no others."""
    wanted = {each.name for each in fields(kind)}
    if not isinstance(item, dict):
        raise TypeError(f"expected a {kind.__name__}, found {item!r:.60}")
    if strange := sorted(item.keys() ^ wanted):
        raise ValueError(f"{', '.join(strange)}: missing from a {kind.__name__}, or no part of one")
    return item


def _text(item: Any) -> str:
    if not isinstance(item, str):
        raise TypeError(f"expected a text, found {item!r:.60}")
    return item


def _whole(item: Any) -> int:
    if type(item) is not int or item < 0:
        raise ValueError(f"expected a whole number, not negative, found {item!r:.60}")
    return item


def _number(item: Any) -> Fraction:
    if not NUMBER.fullmatch(_text(item)):
        raise ValueError(f"expected a whole number or a fraction, found {item}")
    return Fraction(item)


def _one_of(item: Any, names: Sequence[str]) -> Any:
    if item not in names:
        raise ValueError(f"expected one of {', '.join(names)}, found {item!r:.60}")
    return item


def _list(item: Any, read: Callable[[Any], Any]) -> tuple[Any, ...]:
    if not isinstance(item, list):
        raise TypeError(f"expected a list, found {item!r:.60}")
    return tuple(map(read, item))


def _texts(item: Any, count: int) -> tuple[str, ...]:
    found = _list(item, _text)
    if len(found) != count:
        raise ValueError(f"expected {count} texts, found {len(found)}")
    return found


def _named(item: Any) -> dict[str, str]:
    if not isinstance(item, dict):
        raise TypeError(f"expected an object, found {item!r:.60}")
    return {label: _text(out) for label, out in item.items()}


def _claim(item: Mapping[str, Any]) -> Claim:
    return Claim(
        symbols=_list(item["symbols"], _symbol),
        gains=_list(item["gains"], _text),
        program=_program(item["program"]),
        operator=_one_of(item["operator"], ("flow", "sample")),
        moves=_named(item["moves"]),
        plant_moves=_named(item["plant_moves"]),
        reversed=_list(item["reversed"], _text),
        stored_states=_list(item["stored_states"], _text),
        parts=_list(item["parts"], _part),
        composed=_list(item["composed"], lambda each: _texts(each, 4)),
    )


def _symbol(item: Any) -> Symbol:
    found = _with(Symbol, item)
    values = None if found["values"] is None else _list(found["values"], _number)
    return Symbol(_text(found["label"]), _text(found["kind"]), _whole(found["size"]), values)


def _part(item: Any) -> Part:
    found = _with(Part, item)

    def terms(role: str) -> tuple[Term, ...]:
        return _list(found[role], _term)

    return Part(
        block=_text(found["block"]),
        weight=_text(found["weight"]),
        stored=terms("stored"),
        dissipation=terms("dissipation"),
        residual=terms("residual"),
        errors=terms("errors"),
        supply=_text(found["supply"]),
        consumed=None if found["consumed"] is None else _term(found["consumed"]),
        lemma=_text(found["lemma"]),
        memories=_list(found["memories"], lambda each: _texts(each, 3)),
        symmetric=_list(found["symmetric"], lambda each: _texts(each, 2)),
        steps=_list(found["steps"], _steps),
        lines=_list(found["lines"], _line),
        plant=_list(found["plant"], _relation),
        solved=_list(found["solved"], _text),
    )


def _term(item: Any) -> Term:
    found = _with(Term, item)
    return Term(_text(found["name"]), _text(found["rule"]), _named(found["parts"]))


def _steps(item: Any) -> Steps:
    found = _with(Steps, item)
    if not isinstance(found["box"], bool):
        raise TypeError(f"expected a box or none, found {found['box']!r}")
    return Steps(
        rule=_one_of(found["rule"], ("normalised", "least_squares")),
        estimate=_text(found["estimate"]),
        memory=_text(found["memory"]),
        sizes=_list(found["sizes"], _whole),
        rows=_whole(found["rows"]),
        box=found["box"],
        parts=_named(found["parts"]),
    )


def _line(item: Any) -> Line:
    found = _with(Line, item)
    when = None if found["when"] is None else _text(found["when"])
    return Line(_text(found["state"]), _text(found["newest"]), _text(found["before"]), when)


def _relation(item: Any) -> Relation:
    found = _with(Relation, item)
    return Relation(_text(found["momentum"]), _text(found["rest"]))


def _program(item: Any) -> Program:
    if not isinstance(item, dict) or item.keys() != {"inputs", "nodes", "outputs"}:
        raise ValueError(f"expected the inputs, nodes and outputs of a program, found {item!r:.60}")
    inputs = _list(item["inputs"], _input)
    nodes = [_node(place, node, inputs) for place, node in enumerate(_list(item["nodes"], list))]
    outputs, sources = list[Pattern](), list[Sequence[int]]()
    for name, rows, size, given, places in _list(item["outputs"], list):
        own = _list(places, _whole)
        outputs.append(Pattern(_text(name), _whole(rows), _whole(size), _list(given, _whole)))
        sources.append(own)
        if len(outputs[-1].places) != len(own) or not all(k < len(nodes) for k in own) or size % max(rows, 1):
            raise ValueError(f"the output {name}")
    return Program("claim", nodes, inputs, outputs, sources)


def _input(item: Any) -> Pattern:
    name, rows, size = _list(item, lambda each: each)
    return Pattern(_text(name), _whole(rows), _whole(size), range(size))


def _node(place: int, node: Sequence[Any], inputs: Sequence[Pattern]) -> Node:
    name, *given = node
    if name == "const":
        (number,) = given
        return Node(CONST, 0, 0, _number(number), place)  # type: ignore[arg-type]  # `exact` keeps a fraction
    a, b = _whole(given[0]), _whole(given[-1])
    if name == "input":
        if len(given) != 2 or b >= inputs[a].size:
            raise ValueError(f"element {b} of the input {inputs[a].name}, which has {inputs[a].size}")
        return Node(INPUT, a, b, 0.0, place)
    operation = BY_NAME[_text(name)]
    if len(given) != operation.arity or max(a, b) >= place:
        raise ValueError(f"the instruction {place}, {name} of {given}")
    return Node(operation.code, a, b, 0.0, place)
