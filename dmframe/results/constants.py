r"""Unknown constants of a discrete-time certificate, identified from a run by least squares.

The proof holds for every value c of the unknown constants, such as the offset between two integrators. The residual
:math:`r_k(c)`, the largest increase of V in a sample, is a sum of squares of the equation errors of the data rows, so
quadratic in c. The run determines the value with the least sum,

.. math:: \hat c = \arg\min_c \sum_k r_k(c), \quad \hat c = -\Big(\sum_k r_k''\Big)^{-1} \sum_k r_k'(0)

and V is evaluated there: any other value allows V a larger increase.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.certify.claim import Claim, NotApplicableError, total
from dmframe.common.errors import listed, summarised
from dmframe.common.slices import slices
from dmframe.diagram.closed_loop import stack
from dmframe.results.at_instants import AtInstants

SINGULAR: Final = 1e-9
"""Eigenvalues of the scaled sum of r'' up to this leave their direction undetermined."""


@final
@dataclass(frozen=True)
class Constants:
    """Unknown constants in V, with the values identified from a run.

    Parameters
    ----------
    symbols
        By label ``block.name``.
    values
        One number per element, in the same order; 0 if the run does not determine it.
    loose
        Labels of the elements that the run does not determine.
    """

    symbols: Mapping[str, SX]
    values: np.ndarray
    loose: tuple[str, ...] = ()

    def put(self, expression: SX) -> SX:
        """Substitute the values for the symbols in an expression."""
        if not self.symbols:
            return expression
        (found,) = ca.substitute([expression], [stack(self.symbols.values())], [ca.SX(ca.DM(self.values))])
        return found

    @property
    def by_label(self) -> dict[str, np.ndarray]:
        """Values by label."""
        parts = slices(symbol.numel() for symbol in self.symbols.values())
        return {label: self.values[part] for label, part in zip(self.symbols, parts, strict=True)}

    @property
    def text(self) -> str:
        """Description of the constants used for V."""
        shown = [f"{label} = [{summarised([f'{x:.6g}' for x in found], '')}]" for label, found in self.by_label.items()]
        return f"with {listed(shown)}, the unknown constants identified from the run" if shown else ""


def residual_of(claim: Claim) -> SX:
    """Largest increase of V in a sample according to the claim, before its decrease is subtracted."""
    return total([part.residual for part in claim.parts])


def determined(claim: Claim, stored: SX, samples: AtInstants) -> Constants:
    """Identify the unknown constants in the stored expressions from a run.

    Raises
    ------
    NotApplicableError
        The residual is not quadratic in them.
    """
    symbols = {
        f"{part.block}.{name}": stack([symbol])
        for part in claim.parts
        for name, symbol in part.certificate.unknown.items()
        if symbols_in([symbol]) & symbols_in([stored])
    }
    if not symbols:
        return Constants({}, np.zeros(0))
    c = stack(symbols.values())
    slope = ca.gradient(residual_of(claim), c)
    bend = ca.jacobian(slope, c)
    if symbols_in([bend]) & symbols_in([c]):
        raise NotApplicableError(f"V depends on {listed(list(symbols))}, and its residual is not quadratic in them")
    at_zero = ca.substitute([slope], [c], [ca.SX.zeros(c.numel())])[0]
    rows = samples.of(stack([at_zero, ca.vec(ca.densify(bend))]))
    rows = rows[:, np.all(np.isfinite(rows), axis=0)]
    slopes, bends = np.split(np.sum(rows, axis=1), [c.numel()])
    values, loose = _least(slopes, bends.reshape(c.numel(), c.numel()))
    elements = [
        f"{label}[{k + 1}]" if symbol.numel() > 1 else label
        for label, symbol in symbols.items()
        for k in range(symbol.numel())
    ]
    return Constants(symbols, values, tuple(name for name, free in zip(elements, loose, strict=True) if free))


def _least(slope: np.ndarray, bend: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Minimum-norm minimiser of a quadratic form; and a mask of undetermined elements."""
    size = np.sqrt(np.diag(bend))
    scale = np.where(size > 0, size, 1.0)
    eigenvalues, vectors = np.linalg.eigh(bend / np.outer(scale, scale))
    seen = eigenvalues > SINGULAR
    inverse = (vectors[:, seen] / eigenvalues[seen]) @ vectors[:, seen].T
    return -(inverse @ (slope / scale)) / scale, np.any(np.abs(vectors[:, ~seen]) > np.sqrt(SINGULAR), axis=1)


def notes_on(claim: Claim, constants: Constants, samples: AtInstants) -> Iterator[str]:
    """Warnings on constants that the run does not determine, or that are outside the box of their estimate."""
    if constants.loose:
        those = "it" if len(constants.loose) == 1 else "them"
        yield f"no sample of the run determines {summarised(constants.loose)}: V is evaluated with 0 for {those}"
    own = symbols_in(constants.symbols.values())
    for part in claim.parts:
        for item in part.certificate.steps:
            true = ca.vec(ca.densify(ca.SX(item.true)))
            held = [row for row in range(true.numel()) if symbols_in([true[row]]) & own]
            if not item.box or not held:
                continue
            lower, upper = (ca.vec(ca.densify(ca.SX(end)))[held] for end in item.box)
            rows = samples.of(constants.put(stack([lower, true[held], upper])))
            low, at, high = np.split(rows, 3)
            for row in np.flatnonzero(np.any((at < low) | (at > high), axis=1)):
                yield (
                    f"the true value of {part.block}.{item.estimate}[{held[row] + 1}] identified from the run, "
                    f"{at[row, 0]:.3g}, is outside its box from {low[row, 0]:.3g} to {high[row, 0]:.3g}; "
                    "the proof assumes that it is inside"
                )


__all__ = ["Constants", "determined", "notes_on", "residual_of"]
