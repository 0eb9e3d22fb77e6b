"""Power balance between blocks: groups of blocks whose supply rates cancel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final, final

import casadi as ca

from dmframe.certify.claim import Claim, Part, total
from dmframe.certify.points import at_random_point
from dmframe.certify.symbols import Symbols, symbols_of
from dmframe.exact import Tape

_SEEDS: Final = (0, 1)
"""Seeds of the random points, each in its own random prime field."""


@final
@dataclass(frozen=True)
class Exchange:
    """Supply rates of the blocks of a diagram.

    Parameters
    ----------
    groups
        Smallest groups of blocks whose supply rates sum to zero identically; a group of one has a zero supply rate.
    left
        Blocks whose supply rate is not cancelled by any other block.
    """

    groups: tuple[tuple[str, ...], ...]
    left: tuple[str, ...]


def exchange_of(claim: Claim) -> Exchange:
    """Find the smallest groups of blocks whose supply rates cancel, decided in prime fields like a verdict.

    Supply rates with different weights in V are not added: they would cancel for one value of kappa only. Raises
    `DmframeError` for operations that have no prime-field equivalent.
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
    """Blocks grouped by the weight of their storage function in V."""
    if not claim.cascaded:
        return [list(claim.parts)]
    return [[part for part in claim.parts if part.cascade is cascade] for cascade in (False, True)]


def _cancelling(parts: Sequence[Part], size: int, symbols: Symbols) -> tuple[Part, ...] | None:
    """First group of `size` blocks whose supply rates sum to zero at every random point."""
    chosen = list(combinations(parts, size))
    sums = [total([ca.SX(part.certificate.supply) for part in some]) for some in chosen]
    tape = Tape.from_function(symbols.function("supplies", sums))
    points = [at_random_point(tape, symbols, seed) for seed in _SEEDS]
    return next((some for k, some in enumerate(chosen) if not any(any(point[k]) for point in points)), None)
