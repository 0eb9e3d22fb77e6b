"""A claim as JSON, and back: what is written is the object that was checked.

    {"version": 1, "symbols": [...], "gains": [...], "operator": "flow", "moves": {...}, "parts": [...], ...,
     "program": {"inputs": [[name, rows, size]], "outputs": [[name, rows, size, places, nodes]],
                 "nodes": [["add", 3, 4], ["input", 0, 2], ["const", "1/10"], ...]}}

Numbers are exact: decimals as they were written, as fractions.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from fractions import Fraction
from hashlib import sha256
from typing import Any, Final

from dmframe.errors import ValueFault
from dmframe.exact.literal import exact
from dmframe.program import BY_NAME, CONST, INPUT, OPERATIONS, Node, Pattern, Program
from dmframe.prove.claim import Claim, Line, Part, Relation, Steps, Symbol, Term

VERSION: Final = 1


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
    """The claim that a file holds; raises `ValueFault` for another version and for what is no claim."""
    try:
        found = json.loads(text)
        if found["version"] != VERSION:
            raise ValueFault(f"a claim: expected version {VERSION}, found {found['version']!r}")
        return Claim(
            symbols=tuple(_symbol(item) for item in found["symbols"]),
            gains=tuple(found["gains"]),
            program=_program(found["program"]),
            operator=found["operator"],
            moves=found["moves"],
            plant_moves=found["plant_moves"],
            reversed=tuple(found["reversed"]),
            stored_states=tuple(found["stored_states"]),
            parts=tuple(_part(item) for item in found["parts"]),
            composed=tuple((a, b, c, d) for a, b, c, d in found["composed"]),
        )
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise ValueFault(f"a claim: expected what `to_json` writes, found {type(error).__name__}: {error}") from None


def _symbol(item: Mapping[str, Any]) -> Symbol:
    values = item["values"]
    return Symbol(**{**item, "values": None if values is None else tuple(map(Fraction, values))})


def _part(item: Mapping[str, Any]) -> Part:
    def terms(role: str) -> tuple[Term, ...]:
        return tuple(Term(**term) for term in item[role])

    return Part(
        block=item["block"],
        weight=item["weight"],
        stored=terms("stored"),
        dissipation=terms("dissipation"),
        residual=terms("residual"),
        errors=terms("errors"),
        supply=item["supply"],
        consumed=None if item["consumed"] is None else Term(**item["consumed"]),
        lemma=item["lemma"],
        memories=tuple((a, b, c) for a, b, c in item["memories"]),
        symmetric=tuple((a, b) for a, b in item["symmetric"]),
        steps=tuple(Steps(**{**each, "sizes": tuple(each["sizes"])}) for each in item["steps"]),
        lines=tuple(Line(**line) for line in item["lines"]),
        plant=tuple(Relation(**relation) for relation in item["plant"]),
        solved=tuple(item["solved"]),
    )


def _program(item: Mapping[str, Any]) -> Program:
    nodes = [_node(place, node) for place, node in enumerate(item["nodes"])]
    inputs = [Pattern(name, rows, size, range(size)) for name, rows, size in item["inputs"]]
    for code, a, b, _, _ in nodes:
        if code == INPUT and not b < inputs[a].size:
            raise ValueError(f"element {b} of the input {inputs[a].name}, which has {inputs[a].size}")
    outputs, sources = list[Pattern](), list[list[int]]()
    for name, rows, size, places, own in item["outputs"]:
        if len(places) != len(own) or not all(0 <= k < len(nodes) for k in own) or size % max(rows, 1):
            raise ValueError(f"the output {name}")
        outputs.append(Pattern(name, rows, size, places))
        sources.append(own)
    return Program("claim", nodes, inputs, outputs, sources)


def _node(place: int, node: Sequence[Any]) -> Node:
    name, *given = node
    if name == "const":
        return Node(CONST, 0, 0, Fraction(given[0]), place)  # type: ignore[arg-type]  # `exact` keeps a fraction
    if name == "input":
        return Node(INPUT, given[0], given[1], 0.0, place)
    operation = BY_NAME[name]
    if len(given) != operation.arity or not all(0 <= operand < place for operand in given):
        raise ValueError(f"the instruction {place}, {name} of {given}")
    return Node(operation.code, given[0], given[-1], 0.0, place)
