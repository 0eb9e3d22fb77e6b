"""What blocks supply to one another, and which of these supplies add up to zero."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final, final

import casadi as ca

from dmframe.certify.claim import Claim, Part, total
from dmframe.certify.identity import at_random_point
from dmframe.certify.symbols import Symbols, symbols_of
from dmframe.exact import Tape

_SEEDS: Final = (0, 1)
"""Of the random points, each in a random prime field of its own."""


@final
@dataclass(frozen=True)
class Exchange:
    """Supplies of the blocks of a diagram.

    Parameters
    ----------
    groups
        Blocks whose supplies add up to zero identically, the fewest together; a group of one supplies nothing.
    left
        Blocks whose supplies nothing takes away.
    """

    groups: tuple[tuple[str, ...], ...]
    left: tuple[str, ...]


def exchange_of(claim: Claim) -> Exchange:
    """Find the smallest groups of blocks whose supplies cancel, decided in prime fields, as a verdict is.

    Supplies of different weights in V are never added: they would cancel for one weight alone. Raises `DmframeError`
    where they hold what no prime field has.
    """
    symbols = symbols_of(claim)
    groups, left = list[tuple[str, ...]](), list[str]()
    for level in _levels(claim):
        waiting = [part for part in level if not ca.SX(part.certificate.supply).is_zero()]
        size = 1
        while size <= len(waiting):
            found = _cancelling(waiting, size, symbols)
            if found is None:
                size += 1
                continue
            groups.append(tuple(part.block for part in found))
            waiting = [part for part in waiting if part not in found]
        left += [part.block for part in waiting]
    order = [part.block for part in claim.parts]
    return Exchange(tuple(groups), tuple(sorted(left, key=order.index)))


def _levels(claim: Claim) -> list[list[Part]]:
    """The blocks whose storages have one weight in V."""
    if not claim.cascaded:
        return [list(claim.parts)]
    return [[part for part in claim.parts if part.cascade is cascade] for cascade in (False, True)]


def _cancelling(parts: Sequence[Part], size: int, symbols: Symbols) -> tuple[Part, ...] | None:
    """The first so many blocks whose supplies add up to zero at every point."""
    chosen = list(combinations(parts, size))
    sums = [total([ca.SX(part.certificate.supply) for part in some]) for some in chosen]
    tape = Tape.from_function(symbols.function("supplies", sums))
    points = [at_random_point(tape, symbols, seed) for seed in _SEEDS]
    return next((some for k, some in enumerate(chosen) if not any(any(point[k]) for point in points)), None)
