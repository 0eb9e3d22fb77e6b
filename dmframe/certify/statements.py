"""What follows from V and dV/dt: which signals are bounded, square-integrable, and converge; by which step."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import final

import casadi as ca

from dmframe.certificate import Clipped, Lemma, NormSquare, Square
from dmframe.certify.claim import Claim, Part
from dmframe.certify.symbols import Symbols
from dmframe.diagram.model import hashes, symbols_in
from dmframe.exact import zero_test


@final
@dataclass(frozen=True)
class Statement:
    """One sentence about one signal, with the step that gives it and what the step takes for granted."""

    signal: str
    says: str
    step: str
    assumes: tuple[str, ...] = ()


BARBALAT = "a square-integrable signal with a bounded derivative goes to zero [Barbalat's lemma]"
IN_V = "V holds it with a positive weight and does not grow"
ULTIMATELY = (
    "dV/dt spends each square that V holds, or a projection bounds it: dV/dt <= -lambda V + constant, lambda > 0"
)
IN_THE_MEAN = "over a long time, what dV/dt spends is on average no more than the bounded residual"


def statements_of(claim: Claim, symbols: Symbols) -> list[Statement]:
    """Read off V and its dissipation, term by term; they hold if the claim is proved."""
    if any(part.certificate.excess for part in claim.parts):
        return list(_up_to_a_residual(claim, symbols))
    bounded = [Statement(square.of, "is bounded", IN_V) for _, square in _stored(claim)]
    spent = _spent(claim)
    integrable = [
        Statement(of, "is square-integrable", "dV/dt spends it, and V has no more than V(0) to spend") for of in spent
    ]
    converging = [Statement(of, "goes to zero", BARBALAT, (f"the derivative of {of} is bounded",)) for of in spent]
    return [*bounded, *integrable, *converging, *_into_dead_zones(claim)]


def _stored(claim: Claim) -> Iterator[tuple[Part, Square]]:
    for part in claim.parts:
        yield from ((part, term) for term in part.certificate.storage if isinstance(term, Square))


def _spent(claim: Claim) -> list[str]:
    squares = [term.of for part in claim.parts for term in part.certificate.dissipation if isinstance(term, Square)]
    return list(dict.fromkeys(squares))


def _into_dead_zones(claim: Claim) -> Iterator[Statement]:
    for part in claim.parts:
        for term in part.certificate.dissipation:
            if isinstance(term, Lemma) and term.phi == "dead_zone":
                step = "dV/dt spends no less than the square of what it has beyond the dead zone [Barbalat's lemma]"
                yield Statement(term.of, "goes into its dead zone", step, (f"the derivative of {term.of} is bounded",))


def _up_to_a_residual(claim: Claim, symbols: Symbols) -> Iterator[Statement]:
    """Of a claim with a bounded residual: V may rise, so that nothing is bounded only because V holds it."""
    projected = [square for part, square in _stored(claim) if _is_projected(claim, square)]
    left = [(part, square) for part, square in _stored(claim) if square not in projected]
    assumes = tuple(dict.fromkeys(_assumed(claim)))
    if not assumes and all(_is_spent(claim, square, symbols) for _, square in left):
        yield from (Statement(square.of, "is ultimately bounded", ULTIMATELY) for _, square in _stored(claim))
        return
    yield from (
        Statement(square.of, "is bounded", "a projection keeps the estimate in its set") for square in projected
    )
    for of in _spent(claim):
        yield Statement(of, "is bounded in the mean square, by the residual", IN_THE_MEAN, assumes)


def _assumed(claim: Claim) -> Iterator[str]:
    for part in claim.parts:
        for term in part.certificate.excess:
            if isinstance(term, NormSquare):
                yield f"the dissipation of {term.by_of} outgrows |{term.by_of}|"
            elif isinstance(term, Clipped):
                yield f"{term.of} is bounded"


def _is_projected(claim: Claim, square: Square) -> bool:
    """Does it hold a projected estimate, and no other state?"""
    used = symbols_in([square.vector])
    variables = (*claim.loop.controller, *claim.loop.plant)
    moving = {variable.label for variable in variables if used & hashes(variable.symbol)}
    return moving == {p.name for p in claim.loop.projections if used & hashes(p.state)} and len(moving) == 1


def _is_spent(claim: Claim, square: Square, symbols: Symbols) -> bool:
    """Is the square's own vector dissipated, identically?"""
    return any(
        _same(square, term, symbols)
        for part in claim.parts
        for term in part.certificate.dissipation
        if isinstance(term, Square) and term.vector.shape == square.vector.shape
    )


def _same(square: Square, term: Square, symbols: Symbols) -> bool:
    if ca.is_equal(square.vector, term.vector):
        return True
    difference = symbols.function("difference", [square.vector - term.vector])
    return bool(zero_test(difference, values=symbols.fixed, trials=1).zero)
