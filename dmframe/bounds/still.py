r"""Directions in which an adaptation law never moves, and the true values that differ by them only.

A gradient law :math:`\dot{\hat a} = -\Gamma Y^\top \sigma` does not move along the null space of Y: with
:math:`Y n = 0` for all motions, :math:`n^\top \Gamma^{-1} \dot{\hat a} = 0`. V has the same derivative with the true
value :math:`a + n` instead of a, and the projection onto a box adds no positive term as long as :math:`a + n` lies in
the box. So a bound may use the least :math:`\tfrac12 |\hat a(0) - a - n|^2_{\Gamma^{-1}}` over these n. They are known
for the inertial parameters of a chain (`dmframe.regressor`); that the law does not move along them is tested exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Final, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX, Square
from dmframe.block.model import symbols_in
from dmframe.certify.claim import Claim
from dmframe.certify.symbols import Symbols, exact_values
from dmframe.diagram.closed_loop import Variable
from dmframe.diagram.projection import Box
from dmframe.exact import zero_test
from dmframe.regressor.base_parameters import base_parameters

SLACK: Final = 1 + 1e-9
"""Factor that covers the rounding of the coefficients of `nearest`."""


@final
@dataclass(frozen=True, eq=False)
class Still:
    """An estimate, directions in which its law never moves, one a row, and the ends of its box, if it has one."""

    estimate: SX
    directions: np.ndarray
    box: tuple[SX, ...]


def still_of(claim: Claim, symbols: Symbols, term: Square) -> Still | None:
    """Directions for a term that stores the error of an estimate of inertial parameters.

    None for another term, if the law moves along one of the directions, or if the set of the estimate is no box.
    """
    estimate = _estimate(claim, term)
    chain = claim.diagram.robot
    if estimate is None or chain is None:
        return None
    size = 10 * chain.n
    if estimate.symbol.numel() < size or not ca.SX(term.weight).is_column():
        return None
    rows = _null_space(base_parameters(chain, symbolic=False).grouping)
    held = next((item for item in claim.loop.projections if item.name == estimate.label), None)
    if not rows or not (held is None or isinstance(held.set, Box)):
        return None
    (rate,) = claim.loop.joined(claim.loop.rates_of([estimate]) if held is None else [held.nominal])
    n = ca.SX.sym("n", len(rows), size)
    moved = n @ (ca.vec(rate) * term.weight * ca.SX.ones(rate.numel()))[:size]
    exact = exact_values(claim.diagram)
    values: dict[int | str, Sequence[Fraction | int | float | None]] = {
        k: exact[group.label]
        for k, group in enumerate(symbols.groups)
        if group.kind == "parameter" and group.label.startswith("robot.")
    }
    numbers = [row[column] for column in range(size) for row in rows]
    function = symbols.function("still", [moved], [n])
    if not zero_test(function, values={**symbols.fixed, **values, len(symbols.groups): numbers}, trials=2).zero:
        return None
    padded = np.zeros((len(rows), estimate.symbol.numel()))
    padded[:, :size] = [[float(x) for x in row] for row in rows]
    return Still(ca.vec(estimate.symbol), padded, () if held is None else held.set.ends)


def nearest(directions: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The matrix R for which R e is the shortest of e + n in the metric of the weights."""
    scale = np.sqrt(weights)
    basis, _ = np.linalg.qr((directions * scale).T)
    projector = np.eye(len(scale)) - basis @ basis.T
    return np.asarray(projector * scale / scale[:, None])


def _estimate(claim: Claim, term: Square) -> Variable | None:
    """The state whose error a term stores: its vector is the state minus what does not depend on it."""
    for variable in claim.loop.variables:
        same = variable.symbol.shape == term.vector.shape and symbols_in([term.vector]) & variable.identities
        if same and (ca.jacobian(term.vector, variable.symbol) - ca.SX.eye(variable.symbol.numel())).is_zero():
            return variable
    return None


def _null_space(grouping: Sequence[Sequence[Fraction]]) -> list[list[Fraction]]:
    """Null space of a reduced echelon form, whose rows have 1 in their own column and 0 in those of the others."""
    columns = len(grouping[0])
    pivots = [
        next(k for k in range(columns) if row[k] == 1 and not any(other[k] for other in grouping if other is not row))
        for row in grouping
    ]
    found = list[list[Fraction]]()
    for free in sorted(set(range(columns)) - set(pivots)):
        row = [Fraction(0)] * columns
        row[free] = Fraction(1)
        for pivot, each in zip(pivots, grouping, strict=True):
            row[pivot] = -each[free]
        found.append(row)
    return found
