"""Where gathered matrices start: below zero, they stay so for a while, and their form is no storage."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Any

import casadi as ca

from dmframe.block.certificate import SX, InformationSquare, LeastSquaresSteps
from dmframe.block.linalg import ldl
from dmframe.block.model import symbols_in
from dmframe.certify.begun import Begun
from dmframe.certify.checked import Checked, Numbers
from dmframe.certify.claim import Claim, Part
from dmframe.certify.starts import ZERO, begun_at, start_of
from dmframe.common.text import Text, name_of, sentence, square_of
from dmframe.diagram.closed_loop import stack
from dmframe.exact.rational import Interval, evaluate
from dmframe.prove.definite import Number, is_semidefinite

POSITIVE = sentence("{V} is positive")


def memory_starts(claim: Claim, numbers: Numbers, given: Mapping[str, Any]) -> list[Checked]:
    """For each gathered matrix whose start is a number of the graph: whether that is positive semidefinite.

    A start that is zero is left out here; one that is no function of parameters alone is left to the assumption that
    the claim carries. `given` is the graph's key `start`.
    """
    found = dict[Text, Checked]()
    for part in claim.parts:
        for term in (*part.certificate.storage, *part.certificate.dissipation):
            if isinstance(term, InformationSquare):
                start = matrix_start(claim, numbers, given, term.memory)
                if start is not None and any(value != ZERO for row in start for value in row):
                    name = gathered_from_start(part, term)
                    text, holds = "G(0) is symmetric and positive semidefinite", _gathers(start)
                    how, reads = "exact" if holds is not None else "undecided", reads_of(numbers, given, term.memory)
                    found[name] = Checked(name, text, None, holds is True, POSITIVE, how, reads=reads)
    return list(found.values())


def gathered_from_start(part: Part, term: InformationSquare) -> Text:
    """Name of the condition on the start of an information matrix."""
    text = "{block}: start of what {G} gathers for {square} >= 0"
    return sentence(text, block=part.block, square=square_of(term.of, "G"))


def _gathers(start: Sequence[Sequence[Number]]) -> bool | None:
    """Symmetric and positive semidefinite; None where intervals leave that open."""
    if any(isinstance(value, Interval) for row in start for value in row):
        return None  # an interval of each element holds matrices that are not symmetric
    rows = [[Interval.of(value).lower for value in row] for row in start]
    return is_semidefinite(rows) and rows == [list(column) for column in zip(*rows, strict=True)]


def reads_of(numbers: Numbers, given: Mapping[str, Any], states: SX) -> SX:
    """All starts and parameters on which the start of these states depends."""
    begun = begun_at(ca.vec(ca.densify(states)), numbers, given, zero=True)
    found = [*begun.symbols.values(), *(starts for starts in begun.starts.values() if starts is not None)]
    return ca.vertcat(ca.SX(0, 1), *ca.symvar(stack(found)))


def triangle_starts(
    block: str, steps: LeastSquaresSteps, numbers: Numbers, given: Mapping[str, Any]
) -> Iterator[Checked]:
    """Whether the matrices that steps of least squares gather start positive semidefinite; a start of zero is."""
    start = start_of(f"{block}.{steps.memory}", numbers, given)
    known = [value for value in start if isinstance(value, Fraction)]
    if len(known) == len(start) and not any(known):
        return
    name, text = Text(f"{block}: start of ", name_of(steps.memory)), "each G(0) is positive semidefinite"
    label = f"{block}.{steps.memory}"
    states = next((v.symbol for v in numbers.claim.loop.variables if v.label == label), ca.SX(0, 1))
    reads = reads_of(numbers, given, states)
    if len(known) < len(start):
        text = f"{text}; undecided: expected numbers"
        yield Checked(name, text, None, False, POSITIVE, "undecided", reads=reads)
        return
    left, holds = iter(known), True
    for size in steps.parts:
        matrix = [[Fraction()] * size for _ in range(size)]
        for column in range(size):
            for row in range(column, size):
                matrix[row][column] = matrix[column][row] = next(left)
        holds &= is_semidefinite(matrix)
    yield Checked(name, text, None, holds, POSITIVE, reads=reads)


def matrix_start(claim: Claim, numbers: Numbers, given: Mapping[str, Any], matrix: SX) -> list[list[Number]] | None:
    """Where a matrix of states starts; None where that is no number."""
    used, leaves, values = symbols_in([matrix]), list[SX](), list[Number]()
    for variable in claim.loop.variables:
        if not used & variable.identities:
            continue
        elements = ca.vertsplit(ca.vec(variable.symbol))
        for leaf, value in zip(elements, start_of(variable.label, numbers, given), strict=True):
            if leaf.element_hash() in used:
                if value is None:
                    return None
                leaves.append(leaf)
                values.append(value)
    function = ca.Function("matrix", [ca.vertcat(ca.SX(0, 1), *leaves)], [ca.densify(matrix)], {"allow_free": True})
    if function.has_free():
        return None
    (found,) = evaluate(function, [values])
    rows = matrix.shape[0]
    return [[found[column * rows + row] for column in range(rows)] for row in range(rows)]


def pivots_at_start(claim: Claim, numbers: Numbers, given: Mapping[str, Any], matrix: SX) -> Begun:
    """The pivots of a matrix of states where it starts."""
    (matrix,) = claim.loop.joined([matrix])
    return begun_at(ca.vertcat(*ldl(matrix)[1]), numbers, given, zero=True)
