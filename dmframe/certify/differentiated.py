"""The record of all that a proof differentiates by the chain rule: what must neither jump nor hold what has no rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import casadi as ca

from dmframe.block.certificate import SX

DEEP: Final = 20
"""How deep two expressions are compared, to keep what is differentiated twice only once."""


@final
@dataclass(frozen=True, eq=False)
class Differentiated:
    """One entry: `of` in words, beginning with its block, and a column in the leaves of the closed loop."""

    of: str
    expression: SX


@final
class Record:
    """What has been differentiated so far, in order.

    `dmframe.certify.claim.Field.derivative` writes it, so that nothing can be differentiated and not be examined by
    `dmframe.certify.smoothness`: no list has to be kept elsewhere.
    """

    def __init__(self) -> None:
        self._entries = list[Differentiated]()
        self._known = dict[str, list[SX]]()

    def add(self, of: str, expression: SX) -> None:
        """Enter an expression; one that is entered already is not entered twice."""
        column = ca.vec(ca.densify(ca.SX(expression)))
        known = self._known.setdefault(of, [])
        if not any(other.shape == column.shape and ca.is_equal(other, column, DEEP) for other in known):
            known.append(column)
            self._entries.append(Differentiated(of, column))

    def since(self, count: int) -> Sequence[Differentiated]:
        """The entries after the first so many."""
        return self._entries[count:]
