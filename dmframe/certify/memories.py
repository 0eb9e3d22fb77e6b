"""Initial values of information matrices: their forms are storage functions only if these are positive semidefinite."""

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
from dmframe.certify.starts import ZERO, margin_from_start, start_of
from dmframe.common.text import Text, name_of, sentence, square_of
from dmframe.diagram.closed_loop import stack
from dmframe.exact.rational import Interval, evaluate
from dmframe.prove.definite import Number, is_semidefinite

POSITIVE = sentence("{V} is positive")


def memory_starts(claim: Claim, numbers: Numbers, given: Mapping[str, Any]) -> list[Checked]:
    """Condition that each information matrix with a numeric initial value starts positive semidefinite.

    A zero initial value is left out. For one that depends on more than parameters, the claim contains an assumption.
    `given` is the graph's key `start`.
    """
    found = dict[Text, Checked]()
    for part in claim.parts:
        for term in (*part.certificate.storage, *part.certificate.dissipation):
            if isinstance(term, InformationSquare):
                start = matrix_start(claim, numbers, given, term.memory)
                if start is not None and any(value != ZERO for row in start for value in row):
                    name = memory_start_name(part, term)
                    text, holds = "G(0) is symmetric and positive semidefinite", _is_valid_start(start)
                    how, reads = "exact" if holds is not None else "undecided", reads_of(numbers, given, term.memory)
                    found[name] = Checked(name, text, None, holds is True, POSITIVE, how, reads=reads)
    return list(found.values())


def memory_start_name(part: Part, term: InformationSquare) -> Text:
    """Name of the condition on the start of an information matrix."""
    text = "{block}: initial value of {G} for {square} >= 0"
    return sentence(text, block=part.block, square=square_of(term.of, "G"))


def _is_valid_start(start: Sequence[Sequence[Number]]) -> bool | None:
    """Symmetric and positive semidefinite; None if intervals leave it undecided."""
    if any(isinstance(value, Interval) for row in start for value in row):
        return None  # elementwise intervals contain matrices that are not symmetric
    rows = [[Interval.of(value).lower for value in row] for row in start]
    return is_semidefinite(rows) and rows == [list(column) for column in zip(*rows, strict=True)]


def reads_of(numbers: Numbers, given: Mapping[str, Any], states: SX) -> SX:
    """All initial values and parameters on which the initial value of these states depends."""
    begun = margin_from_start(ca.vec(ca.densify(states)), numbers, given, zero=True)
    found = [*begun.symbols.values(), *(starts for starts in begun.starts.values() if starts is not None)]
    return ca.vertcat(ca.SX(0, 1), *ca.symvar(stack(found)))


def triangle_starts(
    block: str, steps: LeastSquaresSteps, numbers: Numbers, given: Mapping[str, Any]
) -> Iterator[Checked]:
    """Condition that the matrices of least-squares steps start positive semidefinite; zero satisfies it."""
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
    """Initial value of a matrix of states; None if it is not numeric."""
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
    """Pivots of a matrix of states at its initial value."""
    (matrix,) = claim.loop.joined([matrix])
    return margin_from_start(ca.vertcat(*ldl(matrix)[1]), numbers, given, zero=True)
