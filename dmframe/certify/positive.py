"""Which terms have a constant positive weight, at the graph's numbers or over its intervals."""

from __future__ import annotations

from typing import final

from dmframe.certificate import Lemma, Square
from dmframe.certify.checked import Numbers
from dmframe.certify.claim import Claim
from dmframe.certify.definite import is_mass_matrix, least_body_pivot
from dmframe.errors import ValueFault


@final
class Signs:
    """Answers once for each term; what cannot be decided is not positive."""

    def __init__(self, claim: Claim, numbers: Numbers) -> None:
        self._claim, self._numbers = claim, numbers
        self._known = dict[int, bool]()
        self._kept = list[object]()  # so that no identity is used twice

    def positive(self, square: Square) -> bool:
        """True for a positive constant, and for the robot's mass matrix."""
        if id(square) not in self._known:
            self._kept.append(square)
            self._known[id(square)] = self._decide(square)
        return self._known[id(square)]

    def spends(self, term: Lemma) -> bool:
        """True for a lemma each element of which has a positive weight."""
        return self._least(term.weight)

    def _decide(self, square: Square) -> bool:
        if square.weight.is_column():
            return self._least(square.weight)
        try:
            return self._numbers.least_pivot((square.weight + square.weight.T) / 2) > 0
        except (ValueFault, ZeroDivisionError):
            return least_body_pivot(self._claim.diagram.robot) > 0 and is_mass_matrix(self._claim, square.weight)

    def _least(self, weight: object) -> bool:
        try:
            return self._numbers.least(weight) > 0
        except (ValueFault, ZeroDivisionError):
            return False
