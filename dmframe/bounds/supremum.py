r"""Upper ends over the intervals of a graph, of single expressions and of products.

The servo's gains are in the storage at the start and in the dissipation, so that the largest storage and the least
dissipation belong to different robots. A product of expressions with few common symbols is therefore enclosed as a
whole: the box is cut into pieces, and on each piece both the range and the mean value form,

.. math:: f(x) \in f(m) + f'(X)\,(X - m),

enclose f in floating-point intervals that are rounded outward.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import product
from typing import Final, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.certify.checked import Numbers
from dmframe.common.errors import ValueFault
from dmframe.exact.enclosure import RULES, Enclosing, Enclosure
from dmframe.exact.literal import literal
from dmframe.exact.rational import Interval
from dmframe.program import TO_READ, read
from dmframe.prove.definite import Number, upper

PIECES: Final = {1: 64, 2: 16, 3: 6, 4: 4}
"""Pieces into which each symbol's interval is cut, by the number of symbols with intervals."""


@final
class Box:
    """The intervals of a graph, with upper ends of expressions over them."""

    def __init__(self, numbers: Numbers) -> None:
        self._numbers = numbers

    def tops(self, expressions: Sequence[SX]) -> list[Fraction]:
        """Upper end of each scalar in parameters and starts."""
        return list(map(upper, self._numbers.enclosed(ca.vertcat(ca.SX(0, 1), *expressions))))

    def tops_of_products(self, first: Sequence[SX], second: Sequence[SX]) -> list[list[Fraction]]:
        """Upper ends of the products of all pairs of scalars, none of which is negative; a row for each of `first`."""
        above = [max(value, Fraction(0)) for value in self.tops([*first, *second])]
        rows, columns = ([*map(self._tied, items)] for items in (first, second))
        return [
            [self._top(one, other, above[k] * above[len(rows) + m]) for m, other in enumerate(columns)]
            for k, one in enumerate(rows)
        ]

    def _top(self, first: _Tied, second: _Tied, apart: Fraction) -> Fraction:
        if not first.open & second.open or len(first.open | second.open) not in PIECES:
            return apart
        whole = self._in_pieces(first.expression * second.expression, sorted(first.open | second.open))
        return apart if whole is None else min(apart, whole)

    def _tied(self, expression: SX) -> _Tied:
        tied = self._numbers.tied(expression)
        used = {symbol.element_hash() for symbol in ca.symvar(tied)}
        return _Tied(tied, frozenset(used & self._intervals.keys()))

    @cached_property
    def _values(self) -> dict[int, tuple[SX, Number]]:
        """Each symbol with its value, by its identity."""
        return {
            symbol.element_hash(): (symbol, value)
            for column, values in zip(*self._numbers.given, strict=True)
            for symbol, value in zip(ca.vertsplit(ca.densify(column)), values, strict=True)
        }

    @cached_property
    def _intervals(self) -> dict[int, tuple[SX, Interval]]:
        return {
            key: (symbol, value)
            for key, (symbol, value) in self._values.items()
            if isinstance(value, Interval) and value.lower < value.upper
        }

    def _in_pieces(self, expression: SX, varied: Sequence[int]) -> Fraction | None:
        """Upper end over the intervals of these symbols; None if a divisor may be zero, or an operation switches."""
        symbols, intervals = zip(*(self._intervals[key] for key in varied), strict=True)
        used = {symbol.element_hash() for symbol in ca.symvar(expression)}
        closed = [self._values[key] for key in used - set(varied)]
        value = ca.vertcat(expression, ca.gradient(expression, ca.vertcat(*symbols)))
        columns = [ca.vertcat(*symbols), ca.vertcat(ca.SX(0, 1), *(symbol for symbol, _ in closed))]
        exact = [Enclosure.around(upper(each)) for _, each in closed]
        boxes = _pieces(intervals)
        middles = [Enclosure.of((box.lower + box.upper) / 2) for box in boxes]
        try:
            program = read(ca.Function("product", columns, [value], TO_READ))
            enclosing = Enclosing(program, RULES, lambda number: Enclosure.around(literal(number)))
        except ValueFault:
            return None
        wide, near = (program.dense(enclosing.values([each, exact]), Enclosure.of(0.0))[0] for each in (boxes, middles))
        mean = near[0]
        for slope, box, middle in zip(wide[1:], boxes, middles, strict=True):
            mean = mean + slope * (box - middle)
        largest = float(np.max(np.minimum(wide[0].upper, mean.upper)))
        return Fraction(largest) if np.isfinite(largest) else None


@final
@dataclass(frozen=True, eq=False)
class _Tied:
    """An expression with ratios and factors inserted, and the identities of its symbols with intervals."""

    expression: SX
    open: frozenset[int]


def _pieces(intervals: Sequence[Interval]) -> list[Enclosure]:
    """The box in pieces: for each symbol an array of its intervals on all pieces."""
    count = PIECES[len(intervals)]
    cells = np.array(list(product(range(count), repeat=len(intervals)))).T
    found = []
    for interval, cell in zip(intervals, cells, strict=True):
        low, high = Enclosure.around(interval.lower).lower, Enclosure.around(interval.upper).upper
        marks = np.linspace(low, high, count + 1)  # whose first and last are the ends themselves
        found.append(Enclosure(marks[cell], marks[cell + 1]))
    return found
