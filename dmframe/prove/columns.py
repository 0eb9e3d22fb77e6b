"""The program of a claim by columns, with the symbols and instructions that some outputs need."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from fractions import Fraction
from typing import Any

from dmframe.program import CONST, INPUT, OPERATIONS, Program, shared
from dmframe.prove.claim import Claim, Out, Symbol

Content = tuple[list[dict[str, Any]], dict[str, Any], list[list[Any]]]


def by_columns(claim: Claim, outs: Sequence[Out], labels: Collection[str]) -> Content:
    """Symbols, program and vectors of these outputs, as JSON data.

    Gains replace their copies; common subexpressions are merged. The program is ``{"operations": names, "code": ...,
    "a": ..., "b": ..., "constants": fractions}``, three numbers for each instruction: its operation and its operands. A
    vector is ``[rows, elements]``, column by column, with -1 for zero. Symbols with these labels are kept if unused.
    """
    copies = {len(claim.symbols) + k: claim.inputs[label] for k, label in enumerate(claim.gains)}
    nodes = [
        node._replace(a=copies[node.a]) if node.code == INPUT and node.a in copies else node
        for node in claim.program.nodes
    ]
    whole = claim.program
    program = shared(Program("certificate", nodes, whole.inputs, whole.outputs, whole.sources))
    sources = {out: program.sources[claim.outputs[out]] for out in outs}
    needed = {source for own in sources.values() for source in own}
    for k in range(len(program.nodes) - 1, -1, -1):
        if k in needed:
            needed.update(program.nodes[k].operands)
    place = {k: position for position, k in enumerate(sorted(needed))}
    used = {program.nodes[k].a for k in needed if program.nodes[k].code == INPUT}
    kept = [k for k, symbol in enumerate(claim.symbols) if k in used or symbol.label in labels]
    vectors = []
    for out in outs:
        pattern = program.outputs[claim.outputs[out]]
        elements = [-1] * pattern.size
        for at, source in zip(pattern.places, sources[out], strict=True):
            elements[at] = place[source]
        vectors.append([pattern.rows, elements])
    position = {k: new for new, k in enumerate(kept)}
    return [_symbol(claim.symbols[k]) for k in kept], _instructions(claim, program, place, position), vectors


def _instructions(
    claim: Claim, program: Program, place: Mapping[int, int], position: Mapping[int, int]
) -> dict[str, Any]:
    constants, index = dict[Fraction, int](), {CONST: 0, INPUT: 1}
    rows = list[tuple[int, int, int]]()
    for k in place:
        code, a, b, constant, _ = program.nodes[k]
        kind = index.setdefault(code, len(index))
        if code == CONST:
            rows.append((kind, constants.setdefault(claim.tape.numbers[constant], len(constants)), 0))
        elif code == INPUT:
            rows.append((kind, position[a], program.inputs[a].places[b]))
        else:
            rows.append((kind, place[a], place[b]))
    names = ["const", "input", *(OPERATIONS[code].name for code in index if code in OPERATIONS)]
    columns = {name: [row[j] for row in rows] for j, name in enumerate(("code", "a", "b"))}
    return {"operations": names, **columns, "constants": [str(value) for value in constants]}


def _symbol(symbol: Symbol) -> dict[str, Any]:
    own: dict[str, Any] = {"label": symbol.label, "kind": symbol.kind, "size": symbol.size}
    return own if symbol.values is None else {**own, "values": [str(value) for value in symbol.values]}
