"""Record of all expressions that a proof differentiates by the chain rule; they must be continuous and have rates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import casadi as ca

from dmframe.block.certificate import SX

DEEP: Final = 20
"""Depth to which two expressions are compared, to store a repeated one only once."""


@final
@dataclass(frozen=True, eq=False)
class Differentiated:
    """One entry: a text that begins with its block, and a column in the independent variables of the loop."""

    of: str
    expression: SX


@final
class Record:
    """Expressions differentiated so far, in order.

    `dmframe.certify.operators.Flow.D` writes it, so that every differentiated expression is examined by
    `dmframe.certify.smoothness`.
    """

    def __init__(self) -> None:
        self._entries = list[Differentiated]()
        self._known = dict[str, list[SX]]()

    def add(self, of: str, expression: SX) -> None:
        """Enter an expression, unless it is entered already."""
        column = ca.vec(ca.densify(ca.SX(expression)))
        known = self._known.setdefault(of, [])
        if not any(other.shape == column.shape and ca.is_equal(other, column, DEEP) for other in known):
            known.append(column)
            self._entries.append(Differentiated(of, column))

    def since(self, count: int) -> Sequence[Differentiated]:
        """Entries after the first `count`."""
        return self._entries[count:]
