"""What has to hold where states start, as an expression in parameters and in the starts themselves."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass
from typing import Final, final

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in

START: Final = "start."
"""Before a state's label, where parameters and starts stand together."""


@final
@dataclass(frozen=True, eq=False)
class Begun:
    """A margin at the start.

    Parameters
    ----------
    margin
        In parameters, and in the symbols of the starts that it reads.
    symbols
        These, by the state's label, of `Claim.starts`.
    starts
        Where each of them starts in the graph, in parameters; None where neither graph nor block says it.
    known
        Identities of the parameters' symbols.
    """

    margin: SX
    symbols: Mapping[str, SX]
    starts: Mapping[str, SX | None]
    known: frozenset[int]

    def at(self, moved: Container[str] = ()) -> SX | None:
        """The margin in parameters and in the starts of the `moved` states; None where another start is not known."""
        kept = [label for label in self.symbols if label not in moved]
        values = [self.starts[label] for label in kept]
        found = [value for value in values if value is not None]
        if len(found) < len(values):
            return None
        margin = self.margin
        if kept:
            (margin,) = ca.substitute([margin], [self.symbols[label] for label in kept], found)
        free = symbols_in(symbol for label, symbol in self.symbols.items() if label in moved)
        return margin if symbols_in([margin]) <= self.known | free else None
