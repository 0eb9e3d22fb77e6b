"""Sampling intervals of a linear loop for all robots in the intervals of a graph.

The box of the uncertain parameters is cut into pieces. On each piece the matrices of the loop are enclosed, and the
storage function of its middle is proved for all of them (`dmframe.analysis.held_storage`). The storage function may
differ from piece to piece, since a robot's parameters are constant.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import product
from math import inf
from typing import Final, final

import casadi as ca
import numpy as np
from flint import arb

from dmframe.analysis.held import HeldLoop, HeldSlopes, own_numbers
from dmframe.analysis.held_storage import HeldSearch, proved_interval
from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.certify.begun import START
from dmframe.certify.uncertain import tie_of
from dmframe.diagram.closed_loop import stack
from dmframe.exact.balls import UndecidedError, ball, precise
from dmframe.exact.rational import Interval

MOST_PIECES: Final = 32
"""Number of pieces after which a sampling interval counts as not proved."""

_MOST_CORNERS: Final = 6
"""Number of uncertain numbers up to which the loops at all corners are searched first."""

_FRACTIONS: Final = (0.9, 0.75, 0.6, 0.45, 0.3, 0.15)
"""Tried intervals, relative to the shortest one of the corners; with few pieces."""

_IN_PIECES: Final = (0.5, 0.2)
"""The same with many pieces."""

_ANGLES: Final = (1.5, 0.8)
"""Tried angles gamma T [rad], after that of the search at the middle; one near zero permits no margin."""

_MARGINS: Final = (3e-2, 1e-2, 1e-3)
"""Tried margins in the Riccati equation; a larger one permits larger pieces and fewer intervals."""

Piece = Sequence[tuple[Fraction, Fraction]]


@final
class _Box:
    """Matrices of a loop over pieces of the box of its uncertain numbers."""

    def __init__(self, slopes: HeldSlopes, symbols: SX, ends: Sequence[tuple[Fraction, Fraction]]) -> None:
        self.ends = tuple(ends)
        self._at, self._own = slopes.function([slopes.loop.p, symbols]), own_numbers(slopes.loop)
        self._corners = _is_convex(slopes, symbols)
        self._known = dict[tuple[Fraction, ...], HeldLoop]()

    @property
    def middle(self) -> HeldLoop:
        """The loop in the middle of the box."""
        return self.point([(low + high) / 2 for low, high in self.ends])

    def point(self, values: Sequence[Fraction]) -> HeldLoop:
        """The loop with these numbers."""
        key = tuple(values)
        if key not in self._known:
            self._known[key] = self._at([self._own, [ball(value) for value in values]])
        return self._known[key]

    def decisive(self, piece: Piece) -> Iterator[HeldLoop]:
        """Loops such that a storage function is proved on the piece if it is for each: corners, or an enclosure."""
        if self._corners:
            yield from (self.point(corner) for corner in product(*piece))
        else:
            yield self._at([self._own, [_hull(low, high) for low, high in piece]])


def _is_convex(slopes: HeldSlopes, symbols: SX) -> bool:
    """True if (A, E) is affine in each symbol, and K depends on none.

    All (A, E) of a piece are then convex combinations of those at its corners, and (2) of
    `dmframe.analysis.held_storage` is convex in (A, E).
    """
    A, E, K = slopes.matrices
    both = ca.veccat(A, E)
    curved = (ca.jacobian(ca.jacobian(both, symbol), symbol) for symbol in ca.vertsplit(symbols))
    return not ca.depends_on(ca.vec(K), symbols) and all(each.is_zero() for each in curved)


def interval_over_box(slopes: HeldSlopes, uncertain: Mapping[str, Sequence[Interval]]) -> float | None:
    """A sampling interval T [s] that is proved for all robots in the box; None if no uncertain number acts on the loop.

    Raises `UndecidedError` if no interval is proved.
    """
    box = _box(slopes, uncertain)
    if box is None:
        return None
    best, angle, W = HeldSearch(box.middle).best()
    if len(box.ends) <= _MOST_CORNERS:
        corners = (HeldSearch(box.point(corner)) for corner in product(*box.ends))
        best = min(best, *(corner.longest(angle, W) for corner in corners))
    few = max(MOST_PIECES // 2 ** len(box.ends) ** 2, 1)
    tried = [(fraction, few) for fraction in _FRACTIONS] + [(fraction, MOST_PIECES) for fraction in _IN_PIECES]
    for fraction, pieces in tried:
        for each in (angle, *_ANGLES):
            found = _proved(box, best * fraction, each, W, pieces)
            if found > 0:
                return found
    raise UndecidedError("no sampling interval is proved for all robots in the intervals")


def _proved(box: _Box, interval: float, angle: float, W: np.ndarray, most: int) -> float:
    """The interval if it is proved over at most that many pieces, rounded down; zero if it is not."""
    least, waiting, count = inf, [box.ends], 0
    while waiting:
        piece = waiting.pop()
        count += 1
        if count + len(waiting) > most:
            return 0.0
        found = _of_piece(box, piece, interval, angle, W)
        if found > 0:
            least = min(least, found)
            continue
        sizes = [(high - low) / max(abs(low), abs(high), Fraction(1, 10**9)) for low, high in piece]
        widest = max(range(len(sizes)), key=sizes.__getitem__)
        if sizes[widest] < Fraction(1, 1000):
            return 0.0
        low, high = piece[widest]
        half = (low + high) / 2
        waiting += [(*piece[:widest], ends, *piece[widest + 1 :]) for ends in ((low, half), (half, high))]
    return least


def _of_piece(box: _Box, piece: Piece, interval: float, angle: float, W: np.ndarray) -> float:
    """The interval that a storage function of the middle, or of a corner, has on the whole piece; zero without one."""
    loops = list(box.decisive(piece))
    middle = [(low + high) / 2 for low, high in piece]
    for at in (middle, *product(*piece)):
        try:
            search = HeldSearch(box.point(at))
        except UndecidedError:  # unstable
            return 0.0
        for margin in _MARGINS:
            storage = search.storage(interval, angle, W, margin)
            found = inf
            for loop in loops if storage is not None else ():
                found = min(found, 0.0 if storage is None else proved_interval(loop, storage))
                if found == 0:
                    break
            if 0 < found < inf:
                return found
    return 0.0


def _box(slopes: HeldSlopes, uncertain: Mapping[str, Sequence[Interval]]) -> _Box | None:
    """Ratios and factors become symbols of their own, so that the parameters that they tie vary together."""
    matrices, symbols, ends = list(slopes.matrices), list[SX](), list[tuple[Fraction, Fraction]]()
    for parameter, meaning, column, given in _substitutions(slopes, uncertain):
        matrices = list(ca.substitute(matrices, [parameter], [meaning]))
        symbols.append(column)
        ends += [(item.lower, item.upper) for item in given]
    used = symbols_in(matrices)
    column = stack(symbols)
    open_ = [k for k in range(column.numel()) if column[k].element_hash() in used]
    if not open_:
        return None
    bound = HeldSlopes(slopes.loop, slopes.states, slopes.held, (matrices[0], matrices[1], matrices[2]))
    return _Box(bound, column[open_], [ends[k] for k in open_])


def _substitutions(
    slopes: HeldSlopes, uncertain: Mapping[str, Sequence[Interval]]
) -> Iterator[tuple[SX, SX, SX, Sequence[Interval]]]:
    """Each parameter, its value in a symbol with intervals, that symbol, and the intervals; ratios come first."""
    columns = {p.label: (ca.vec(p.symbol), p.value.ravel(order="F")) for p in slopes.loop.parameters}
    ties = {label: tie_of(label) for label in uncertain if not label.startswith(START)}
    tied = {first for tie in ties.values() if tie is not None for first in tie[:1]}
    order = sorted(ties, key=lambda label: not (ties[label] or ("", ""))[1])
    for label in order:
        given, tie = uncertain[label], ties[label]
        column = ca.SX.sym(label, len(given))
        if tie is None and label not in tied:
            yield columns[label][0], column, column, given
        elif tie is not None:
            first, second = tie
            other = columns[second][0] if second else ca.SX(ca.DM(columns[first][1]))
            yield columns[first][0], column * other, column, given


@precise()
def _hull(low: Fraction, high: Fraction) -> arb:
    return ball(low).union(ball(high))


__all__ = ["MOST_PIECES", "interval_over_box"]
