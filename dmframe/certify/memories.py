"""Where gathered matrices start: below zero, they stay so for a while, and their form is no storage."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fractions import Fraction
from typing import Any

import casadi as ca

from dmframe.block.model import symbols_in
from dmframe.certificate import SX, Gathered, LeastSquaresSteps
from dmframe.certify.checked import Checked, Numbers
from dmframe.certify.claim import Claim
from dmframe.certify.definite import Number, is_semidefinite
from dmframe.certify.starts import start_of
from dmframe.exact.rational import Interval, evaluate


def memory_starts(claim: Claim, numbers: Numbers, given: Mapping[str, Any]) -> list[Checked]:
    """For each gathered matrix whose start is a number of the graph: whether that is positive semidefinite.

    A start that is zero is left out here; one that is no function of parameters alone is left to the assumption that
    the claim carries. `given` is the graph's key `start`.
    """
    found = dict[str, Checked]()
    for part in claim.parts:
        for term in (*part.certificate.storage, *part.certificate.dissipation):
            if isinstance(term, Gathered):
                matrix = matrix_start(claim, numbers, given, term.memory)
                start = None if matrix is None else [[Interval.of(value).lower for value in row] for row in matrix]
                if start is not None and any(map(any, start)):
                    name = f"{part.block}: start of what G gathers for |{term.of}|_G^2 >= 0"
                    mirrored = [list(column) for column in zip(*start, strict=True)]
                    holds = is_semidefinite(start) and start == mirrored
                    found[name] = Checked(
                        name, "G(0) is symmetric and positive semidefinite", None, holds, "V is positive"
                    )
    return list(found.values())


def triangle_starts(
    block: str, steps: LeastSquaresSteps, numbers: Numbers, given: Mapping[str, Any]
) -> Iterator[Checked]:
    """Whether the matrices that steps of least squares gather start positive semidefinite; a start of zero is."""
    start = start_of(f"{block}.{steps.memory}", numbers, given)
    known = [value for value in start if isinstance(value, Fraction)]
    if len(known) == len(start) and not any(known):
        return
    name, text = f"{block}: start of {steps.memory}", "each G(0) is positive semidefinite"
    if len(known) < len(start):
        yield Checked(name, f"{text}; undecided: expected numbers", None, False, "V is positive", "undecided")
        return
    left, holds = iter(known), True
    for size in steps.parts:
        matrix = [[Fraction()] * size for _ in range(size)]
        for column in range(size):
            for row in range(column, size):
                matrix[row][column] = matrix[column][row] = next(left)
        holds &= is_semidefinite(matrix)
    yield Checked(name, text, None, holds, "V is positive")


def matrix_start(claim: Claim, numbers: Numbers, given: Mapping[str, Any], matrix: SX) -> list[list[Number]] | None:
    """Where a matrix of states starts; None where that is no number."""
    used, leaves, values = symbols_in([matrix]), list[SX](), list[Number]()
    for variable in claim.loop.variables:
        if not used & symbols_in([variable.symbol]):
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
