"""Sampling intervals of a loop for all robots in the intervals of a graph, and for all slopes of its plant.

One storage function is proved for all matrices (A, E) of the box (`dmframe.analysis.held_storage`). Inequality (2)
there is convex in (A, E): it is decided at the corners of the box if (A, E) is affine in each uncertain number and K
depends on none, since all (A, E) are then convex combinations of those at the corners; else at the corners of the
enclosures of the elements of A and E over the box.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import product
from typing import Final

import casadi as ca
import numpy as np
from flint import arb

from dmframe.analysis.held import HeldLoop, HeldSlopes, own_numbers
from dmframe.analysis.held_storage import find_storage
from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.certify.begun import START
from dmframe.certify.uncertain import tie_of
from dmframe.diagram.closed_loop import stack
from dmframe.exact.ball_matrix import middles
from dmframe.exact.balls import ball, precise
from dmframe.exact.rational import Interval

MOST_CORNERS: Final = 8
"""Number of uncertain numbers up to which the corners of their box are enumerated."""

Ends = Sequence[tuple[Fraction, Fraction]]


def interval_over_box(slopes: HeldSlopes, uncertain: Mapping[str, Sequence[Interval]]) -> float:
    """A sampling interval T [s] that is proved for all robots in the box and all slopes.

    Raises `UndecidedError` if no interval is proved.
    """
    matrices, symbols, ends = _tied(slopes, uncertain)
    own = own_numbers(slopes.loop)
    bound = HeldSlopes(slopes.loop, slopes.states, slopes.held, matrices)
    function = bound.function([slopes.loop.p, symbols])

    def at(*values: Fraction) -> HeldLoop:
        return function([own, [ball(value) for value in values]])

    if not (bound.linear and len(ends) <= MOST_CORNERS and _is_affine(bound, symbols)):
        return find_storage(function([own, [_hull(*pair) for pair in ends]])).interval
    middle = [(low + high) / 2 for low, high in ends]
    directions = []
    for k, (low, high) in enumerate(ends):
        first, last = (at(*middle[:k], end, *middle[k + 1 :]) for end in (low, high))
        directions.append((_numbers(last) - _numbers(first)) / 2)
    return find_storage(at(*middle), [at(*corner) for corner in product(*ends)], directions).interval


def _numbers(loop: HeldLoop) -> np.ndarray:
    return np.hstack([middles(loop.A), middles(loop.E)])


def _is_affine(slopes: HeldSlopes, symbols: SX) -> bool:
    """True if (A, E) is affine in each symbol, and K depends on none."""
    A, E, K = slopes.matrices
    both = ca.veccat(A, E)
    curved = (ca.jacobian(ca.jacobian(both, symbol), symbol) for symbol in ca.vertsplit(symbols))
    return not ca.depends_on(ca.vec(K), symbols) and all(each.is_zero() for each in curved)


def _tied(
    slopes: HeldSlopes, uncertain: Mapping[str, Sequence[Interval]]
) -> tuple[tuple[SX, SX, SX], SX, list[tuple[Fraction, Fraction]]]:
    """The matrices in symbols of their own for ratios and factors, which symbols act on them, and their intervals."""
    matrices, symbols, ends = list(slopes.matrices), list[SX](), list[tuple[Fraction, Fraction]]()
    for parameter, meaning, column, given in _substitutions(slopes, uncertain):
        matrices = list(ca.substitute(matrices, [parameter], [meaning]))
        symbols.append(column)
        ends += [(item.lower, item.upper) for item in given]
    column, used = stack(symbols), symbols_in(matrices)
    acting = [k for k in range(column.numel()) if column[k].element_hash() in used]
    chosen = ca.vertcat(ca.SX(0, 1), *(column[k] for k in acting))
    return (matrices[0], matrices[1], matrices[2]), chosen, [ends[k] for k in acting]


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


__all__ = ["MOST_CORNERS", "interval_over_box"]
