"""Terms with a constant positive weight, at the graph's numbers or over its intervals."""

from __future__ import annotations

from typing import final

from dmframe.block.certificate import Lemma, LogDet, Potential, Square
from dmframe.certify.assumed import decidable, is_assumed
from dmframe.certify.checked import Numbers
from dmframe.certify.claim import Claim
from dmframe.certify.definite import is_mass_matrix, is_matrix, least_body_pivot

Positive = Square | Potential | LogDet
"""Terms that are positive definite and radially unbounded in the error of their vector."""


@final
class Signs:
    """Decides the sign of each term once; an undecided term counts as not positive."""

    def __init__(self, claim: Claim, numbers: Numbers) -> None:
        self._claim, self._numbers = claim, numbers
        self._known = dict[int, bool]()
        self._kept = list[object]()  # keeps the terms alive, so that their identities stay unique

    def positive(self, term: Positive) -> bool:
        """True for a positive constant, and for the robot's mass matrix."""
        if id(term) not in self._known:
            self._kept.append(term)
            self._known[id(term)] = self._decide(term)
        return self._known[id(term)]

    def may_grow(self, term: Square) -> bool:
        """True for a weight that is assumed positive and may be unbounded."""
        return is_assumed(term, self._numbers)

    def dissipates(self, term: Lemma) -> bool:
        """True for a lemma term whose elements all have positive weights."""
        return self._numbers.above(term.weight)

    def _decide(self, term: Positive) -> bool:
        claim, above = self._claim, self._numbers.above
        if isinstance(term, Potential):
            return above(term.weight) and above(term.width)
        if isinstance(term, LogDet):
            return above(term.weight) and above(term.true, matrix=True)
        if is_assumed(term, self._numbers):
            known = decidable(term.weight, self._numbers)
            return known.is_empty() or above(known)
        if not is_matrix(claim, term.weight):
            return above(term.weight)
        if above((term.weight + term.weight.T) / 2, matrix=True):
            return True
        return is_mass_matrix(claim, term.weight) and least_body_pivot(claim.diagram.robot) > 0
