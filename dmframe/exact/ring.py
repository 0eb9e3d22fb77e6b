"""Evaluation of a tape in any ring: residues, sizes, or reals."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any, Protocol

from dmframe.exact.tape import Tape
from dmframe.program import BY_NAME, CONST, INPUT, OPERATIONS

_ADD, _SUB, _MUL, _DIV, _NEG, _SQ, _TWICE, _INV = (
    BY_NAME[name].code for name in ("add", "sub", "mul", "div", "neg", "sq", "twice", "inv")
)


class Ring(Protocol):
    """Numbers with +, - and *, and the further operations of a program. The type of a number depends on the ring."""

    def number(self, value: Fraction) -> Any:
        """An exact number."""

    def reduced(self, value: Any) -> Any:
        """The same number in a canonical, small representation."""

    def inverse(self, value: Any) -> Any:
        """1 / value; raises if the value is zero."""

    def power(self, value: Any, exponent: int) -> Any:
        """An integer power."""

    def call(self, name: str, *arguments: Any) -> Any:
        """The value of an operation, by CasADi's name."""


def compute(
    tape: Tape, ring: Ring, values: list[Any], inputs: Sequence[Sequence[Any]], places: Iterable[int] | None = None
) -> None:
    """Enter the values of the instructions at `places`, in order; by default of all."""
    given, nodes, reduced = tape.program.elements(inputs), tape.nodes, ring.reduced
    for place in range(len(nodes)) if places is None else places:
        code, a, b, constant, _ = nodes[place]
        if code == INPUT:
            found = given[a][b]
        elif code == CONST:
            found = ring.number(tape.numbers[constant])
        elif code == _MUL:
            found = reduced(values[a] * values[b])
        elif code == _ADD:
            found = values[a] + values[b]
        elif code == _SUB:
            found = values[a] - values[b]
        elif code == _NEG:
            found = -values[a]
        elif code == _SQ:
            found = ring.power(values[a], 2)
        elif code == _TWICE:
            found = 2 * values[a]
        elif code in (_DIV, _INV):
            inverse = ring.inverse(values[b])
            found = reduced(values[a] * inverse) if code == _DIV else inverse
        elif (exponent := tape.exponent(place)) is not None:
            found = ring.power(values[a], exponent)
        else:
            operation = OPERATIONS[code]
            operands = (values[a], values[b]) if operation.arity == 2 else (values[a],)
            found = ring.call(operation.name, *operands)
        values[place] = found


def evaluated(
    tape: Tape, ring: Ring, inputs: Sequence[Sequence[Any]], places: Iterable[int] | None = None
) -> list[Any]:
    """Values of all instructions, or of those at `places`; the others are 0."""
    values: list[Any] = [0] * len(tape)
    compute(tape, ring, values, inputs, places)
    return values


def needed(tape: Tape, outputs: Iterable[int]) -> tuple[int, ...]:
    """Positions of the instructions that these outputs depend on, in order."""
    required = {place for j in outputs for place in tape.program.sources[j]}
    for place in range(len(tape) - 1, -1, -1):
        if place in required:
            required.update(tape.nodes[place].operands)
    return tuple(sorted(required))


def dependencies(tape: Tape, inputs: Mapping[int, int]) -> list[int]:
    """The inputs that each instruction depends on, as the union of their bits; `inputs` has the bits by position."""
    masks, arity = list[int](), {code: operation.arity for code, operation in OPERATIONS.items()}
    for code, a, b, _, _ in tape.nodes:
        if code == INPUT:
            masks.append(inputs.get(a, 0))
        elif code == CONST:
            masks.append(0)
        else:
            masks.append(masks[a] | masks[b] if arity[code] == 2 else masks[a])
    return masks
