"""The program of a claim by columns, with the symbols and instructions that some outputs need."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from fractions import Fraction
from typing import Any, final

from dmframe.program import CONST, INPUT, OPERATIONS, Program, shared
from dmframe.prove.claim import Claim, Out, Symbol

Content = tuple[list[dict[str, Any]], dict[str, Any], list[list[Any]]]


def by_columns(claim: Claim, outs: Sequence[Out], labels: Collection[str]) -> Content:
    """Symbols, program and vectors of these outputs, as JSON data.

    Gains replace their copies; common subexpressions are merged, and negatives, squares, doubles, inverses and whole
    powers become sums, products and quotients. The program is ``{"operations": names, "code": ..., "a": ..., "b": ...,
    "constants": fractions}``, three numbers for each instruction: its operation and its operands. A vector is ``[rows,
    elements]``, column by column, with -1 for zero. Symbols with these labels are kept if unused.
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
    used = {program.nodes[k].a for k in needed if program.nodes[k].code == INPUT}
    kept = [k for k, symbol in enumerate(claim.symbols) if k in used or symbol.label in labels]
    position = {k: new for new, k in enumerate(kept)}
    instructions, place = _instructions(claim, program, sorted(needed), position)
    vectors = []
    for out in outs:
        pattern = program.outputs[claim.outputs[out]]
        elements = [-1] * pattern.size
        for at, source in zip(pattern.places, sources[out], strict=True):
            elements[at] = place[source]
        vectors.append([pattern.rows, elements])
    return [_symbol(claim.symbols[k]) for k in kept], instructions, vectors


def _instructions(
    claim: Claim, program: Program, needed: Sequence[int], position: Mapping[int, int]
) -> tuple[dict[str, Any], dict[int, int]]:
    """Columns of the needed instructions, and the place of each."""
    rows, place = _Rows(), dict[int, int]()
    numbers = {k: claim.tape.numbers[program.nodes[k].constant] for k in needed if program.nodes[k].code == CONST}
    for k in needed:
        code, a, b, _, _ = program.nodes[k]
        if code == CONST:
            place[k] = rows.constant(numbers[k])
        elif code == INPUT:
            place[k] = rows.add("input", position[a], program.inputs[a].places[b])
        else:
            place[k] = rows.operation(OPERATIONS[code].name, place[a], place[b], numbers.get(b))
    columns = {name: [row[j] for row in rows.rows] for j, name in enumerate(("code", "a", "b"))}
    return {"operations": list(rows.names), **columns, "constants": list(map(str, rows.constants))}, place


@final
class _Rows:
    """Instructions with the operations that a checker knows."""

    def __init__(self) -> None:
        self.rows, self.names = list[tuple[int, int, int]](), {"const": 0, "input": 1}
        self.constants = dict[Fraction, int]()

    def add(self, name: str, a: int, b: int) -> int:
        self.rows.append((self.names.setdefault(name, len(self.names)), a, b))
        return len(self.rows) - 1

    def constant(self, value: Fraction) -> int:
        return self.add("const", self.constants.setdefault(value, len(self.constants)), 0)

    def operation(self, name: str, a: int, b: int, exponent: Fraction | None) -> int:
        """Enter an operation; return its place. `exponent`: the second operand, if it is a number."""
        if name == "neg":
            return self.add("sub", self.constant(Fraction(0)), a)
        if name == "inv":
            return self.add("div", self.constant(Fraction(1)), a)
        if name in ("sq", "twice"):
            return self.add("mul" if name == "sq" else "add", a, a)
        if name in ("pow", "constpow") and exponent is not None and exponent.denominator == 1 and abs(exponent) < 100:
            power = self.constant(Fraction(1))
            for _ in range(abs(int(exponent))):
                power = self.add("mul", power, a)
            return power if exponent >= 0 else self.add("div", self.constant(Fraction(1)), power)
        return self.add(name, a, b)


def _symbol(symbol: Symbol) -> dict[str, Any]:
    own: dict[str, Any] = {"label": symbol.label, "kind": symbol.kind, "size": symbol.size}
    return own if symbol.values is None else {**own, "values": [str(value) for value in symbol.values]}
