"""Matrices that weigh squares: positive definite, decided by rational factors or by the bodies that the links are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np

from dmframe.certificate import SX, Gathered
from dmframe.certify.claim import Claim
from dmframe.certify.symbols import symbols_of
from dmframe.diagram.model import told_by
from dmframe.diagram.view import view
from dmframe.exact import zero_test
from dmframe.exact.rational import Interval, evaluate
from dmframe.robot.rational import decimal

Number = Fraction | Interval


def pivots(matrix: Sequence[Sequence[Number]]) -> list[Fraction]:
    """The diagonal of LDL', exactly, up to the first pivot that is not positive; of an interval, its lower end."""
    rows: list[list[Any]] = [list(row) for row in matrix]
    if any(isinstance(value, Interval) for row in rows for value in row):
        rows = [[Interval.of(value) for value in row] for row in rows]
    found = list[Fraction]()
    for j in range(len(rows)):
        pivot = rows[j][j]
        found.append(pivot.lower if isinstance(pivot, Interval) else pivot)
        if found[-1] <= 0:
            break
        for i in range(j + 1, len(rows)):
            factor = rows[i][j] / pivot
            rows[i] = [above - factor * below for above, below in zip(rows[i], rows[j], strict=True)]
    return found


def is_semidefinite(matrix: Sequence[Sequence[Fraction]]) -> bool:
    """True where no direction makes the form of a symmetric matrix negative, decided exactly."""
    rows = [list(row) for row in matrix]
    while rows:
        pivot, across = rows[0][0], rows[0][1:]
        if pivot < 0 or (pivot == 0 and any(across)):
            return False
        rows = [
            [value - (left * above / pivot if pivot else 0) for value, above in zip(row[1:], across, strict=True)]
            for row, left in zip(rows[1:], across, strict=True)
        ]
    return True


def pseudo_inertia(row: Sequence[Fraction]) -> list[list[Fraction]]:
    r"""[[tr(I)/2 1 - I, h], [h', m]] of ten inertial parameters [Wensing2018]_."""
    m, x, y, z, xx, xy, yy, xz, yz, zz = row
    half = (xx + yy + zz) / 2
    return [[half - xx, -xy, -xz, x], [-xy, half - yy, -yz, y], [-xz, -yz, half - zz, z], [x, y, z, m]]


def least_body_pivot(robot: Any) -> Fraction:
    """Above zero iff each link's inertia is that of some mass distribution, which makes M(q) > 0 at every q."""
    return min(min(pivots(pseudo_inertia(row))) for row in robot.inertia)


def negative_memories(claim: Claim) -> list[str]:
    """What is gathered and starts below zero, where the start is a number of the graph: it stays so for a while.

    A start that is not given is zero; one that a block computes is left to the assumption that the claim carries.
    """
    found = dict[str, None]()
    for part in claim.parts:
        for term in (*part.certificate.storage, *part.certificate.dissipation):
            if isinstance(term, Gathered):
                start = _start_of(claim, part.block, term.memory)
                if start is not None and not is_semidefinite(start):
                    text = f"{part.block}: G of |{term.of}|_G^2 starts below zero; expected a positive semidefinite one"
                    found[text] = None
    return list(found)


def _start_of(claim: Claim, block: str, memory: SX) -> list[list[Fraction]] | None:
    """G at the start; None where it depends on more than its block's own states and their given numbers."""
    model, seen = claim.diagram.models[block], view(claim.diagram, block, claim.truths)
    with told_by(block, "start()"):
        said = model.block.start(seen.u, seen.p, seen.truth)
    if set(said) & set(model.states) - set(model.values):
        return None
    own = [np.broadcast_to(model.values.get(name, 0.0), leaf.shape) for name, leaf in model.states.items()]
    leaves = ca.vertcat(ca.SX(0, 1), *(ca.vec(leaf) for leaf in model.states.values()))
    function = ca.Function("G", [leaves], [ca.densify(memory)], {"allow_free": True})
    if function.has_free():
        return None
    flat = [decimal(float(x)) for value in own for x in np.ravel(value, order="F")]
    (values,) = evaluate(function, [flat])
    rows = memory.shape[0]
    return [[Interval.of(values[column * rows + row]).lower for column in range(rows)] for row in range(rows)]


def is_mass_matrix(claim: Claim, weight: SX) -> bool:
    """Is a weight, identically, the mass matrix of the diagram's robot at a state of its plant?"""
    symbols = symbols_of(claim)
    for q, robot in _poses(claim):
        if weight.shape == (robot.n, robot.n):
            difference = symbols.function("difference", [weight - robot.mass_matrix(q)])
            if zero_test(difference, values=symbols.fixed).zero:
                return True
    return False


def _poses(claim: Claim) -> Iterator[tuple[SX, Any]]:
    for variable in claim.loop.plant:
        robot = claim.diagram.models[variable.block].robot
        if robot is not None and variable.symbol.numel() == robot.n:
            yield variable.symbol, robot


def least_sampled(claim: Claim, weight: SX) -> float:
    """The least eigenvalue of a weight at 200 sampled states."""
    loop = claim.loop
    function = ca.Function("W", [loop.state, loop.p], [weight])
    rng = np.random.default_rng(0)
    states = rng.uniform(-np.pi, np.pi, (200, loop.state.numel()))
    return min(float(np.linalg.eigvalsh(function(state, loop.p_values).full())[0]) for state in states)
