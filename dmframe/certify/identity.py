"""The exact test of a claim: dV/dt of the diagram, each block's own claim, and how sigma is composed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import casadi as ca
import numpy as np

from dmframe.certificate import SX
from dmframe.certify.claim import Claim, Part
from dmframe.certify.symbols import Symbols
from dmframe.exact import Tape, ZeroTest, zero_test

POINTS = 4
"""Real points at which a doubtful refutation is looked at again."""

ROUNDING = 1e-9
"""What rounding may leave of a residual that is zero, in proportion to its terms."""


@final
@dataclass(frozen=True)
class Equality:
    """An expression that must vanish identically, and the block whose word it is; none for the diagram's dV/dt.

    `scale` is the sum of the absolute values of its terms.
    """

    block: str
    says: str
    expression: SX
    scale: SX


def equalities(claim: Claim) -> list[Equality]:
    """All that a claim says to be zero; the diagram's own comes first.

    The blocks' own claims are not needed for dV/dt of the diagram, where the supplies cancel; but a block whose supply
    is not what it says could not be built upon.
    """
    found = [Equality("", "dV/dt", claim.residual, _scale(claim))]
    found += [Equality(part.block, "dS/dt", part.residual, _own_scale(part)) for part in claim.parts]
    if claim.cascaded:
        for part in claim.parts:
            if part.certificate.sigma:
                difference = composed(part) - claim.sigma
                found.append(Equality(part.block, "sigma", difference, ca.fabs(composed(part)) + ca.fabs(claim.sigma)))
    return found


def composed(part: Part) -> SX:
    """Sigma as the paying block composes it of what it dissipates."""
    vectors = [term.pieces[0] for term in part.paying]
    return sum((share * vector for share, vector in zip(part.certificate.sigma, vectors, strict=True)), ca.SX(0))


def _scale(claim: Claim) -> SX:
    own = sum((ca.fabs(claim.weight(part)) * _own_scale(part) for part in claim.parts), ca.SX(0))
    return own + ca.fabs(claim.consumption)


def _own_scale(part: Part) -> SX:
    terms = (part.rate, part.certificate.supply, part.dissipation, part.excess, part.lemma)
    return sum((ca.fabs(ca.SX(term)) for term in terms), ca.SX(0))


def check_identity(claim: Claim, symbols: Symbols, *, trials: int, seed: int) -> ZeroTest:
    """Does everything vanish that the claim says to be zero?

    Raises `ValueFault` where it is nowhere defined, such as with a Jacobian that never has full rank.
    """
    expressions = [equality.expression for equality in equalities(claim)]
    return zero_test(symbols.function("residual", expressions), values=symbols.fixed, trials=trials, seed=seed)


def is_trivial(claim: Claim, symbols: Symbols, seed: int) -> bool:
    """A zero residual of V = 0 or dV/dt = 0 would prove nothing."""
    tests = (
        zero_test(symbols.function("V", [claim.V]), values=symbols.fixed, seed=seed, trials=1),
        zero_test(symbols.function("dV", [claim.rate]), values=symbols.fixed, seed=seed, trials=1),
    )
    return any(test.zero for test in tests)


def holds_in_reals(claim: Claim, symbols: Symbols, seed: int) -> bool:
    """Does all of it vanish to rounding at real points, though not for free values of tanh, sqrt and the like?

    Then the exact test lacks a property of such a function, and neither proves nor refutes.
    """
    stated = equalities(claim)
    function = symbols.function("residual", [e.expression for e in stated] + [e.scale for e in stated])
    if not Tape.from_function(function).has_opaque:
        return False
    rng = np.random.default_rng(seed)
    return all(_vanishes(function, _real_point(symbols, rng), len(stated)) for _ in range(POINTS))


def _vanishes(function: Any, point: Sequence[np.ndarray], count: int) -> bool:
    values = [np.ravel(value.full()) for value in function.call([ca.DM(x) for x in point])]
    left, scale = values[:count], values[count:]
    return all(bool(np.all(np.abs(x) <= ROUNDING * (s + 1e-6))) for x, s in zip(left, scale, strict=True))


def _real_point(symbols: Symbols, rng: np.random.Generator) -> list[np.ndarray]:
    """Signals of both signs, parameters above zero."""
    point = []
    for group in symbols.groups:
        if group.values is not None:
            point.append(np.array([float(value) for value in group.values]))
        elif group.kind == "parameter":
            point.append(rng.uniform(0.5, 2, group.symbol.numel()))
        else:
            point.append(rng.uniform(-1.5, 1.5, group.symbol.numel()))
    return point
