"""What follows from V and dV/dt: which signals are bounded, square-integrable, and converge; by which step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from dmframe.certificate import Square
from dmframe.certify.claim import Claim


@final
@dataclass(frozen=True)
class Statement:
    """One sentence about one signal, with the step that gives it and what the step takes for granted."""

    signal: str
    says: str
    step: str
    assumes: tuple[str, ...] = ()


BARBALAT = "a square-integrable signal with a bounded derivative goes to zero [Barbalat's lemma]"


def statements_of(claim: Claim) -> list[Statement]:
    """Read off V and its dissipation, term by term; they hold if the claim is proved."""
    stored = [square.of for part in claim.parts for square in part.certificate.storage]
    bounded = [Statement(of, "is bounded", "V holds it with a positive weight and does not grow") for of in stored]
    squares = [term.of for part in claim.parts for term in part.certificate.dissipation if isinstance(term, Square)]
    spent = list(dict.fromkeys(squares))
    integrable = [
        Statement(of, "is square-integrable", "dV/dt spends it, and V has no more than V(0) to spend") for of in spent
    ]
    converging = [Statement(of, "goes to zero", BARBALAT, (f"the derivative of {of} is bounded",)) for of in spent]
    return [*bounded, *integrable, *converging]
