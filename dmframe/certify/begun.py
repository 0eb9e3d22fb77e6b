"""Margins at the initial state, as expressions in parameters and in the initial values themselves."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass
from typing import Final, final

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in

START: Final = "start."
"""Prefix of a state's label in lists of parameters and initial values."""


@final
@dataclass(frozen=True, eq=False)
class Begun:
    """A margin at the initial state.

    Parameters
    ----------
    margin
        Expression in parameters and in the symbols of the initial values that it contains.
    symbols
        These symbols of `Claim.starts`, by the state's label.
    starts
        The graph's initial value of each of them, in parameters and these symbols; None if neither graph nor block
        states it.
    known
        Identities of the parameters' symbols.
    """

    margin: SX
    symbols: Mapping[str, SX]
    starts: Mapping[str, SX | None]
    known: frozenset[int]

    def at(self, moved: Container[str] = ()) -> SX | None:
        """The margin as a function of parameters and of the `moved` initial values; None if another one is unknown."""
        kept = [label for label in self.symbols if label not in moved]
        values = [self.starts[label] for label in kept]
        found = [value for value in values if value is not None]
        if len(found) < len(values):
            return None
        margin, symbols = self.margin, [self.symbols[label] for label in kept]
        for _ in kept:  # the initial value of a state may contain that of another
            if not symbols_in([margin]) & symbols_in(symbols):
                break
            (margin,) = ca.substitute([margin], symbols, found)
        free = symbols_in(symbol for label, symbol in self.symbols.items() if label in moved)
        return margin if symbols_in([margin]) <= self.known | free else None
