r"""Upper ends over the intervals of a graph, of single expressions and of products.

The servo's gains are in the storage at the start and in the dissipation, so that the largest storage and the least
dissipation belong to different robots. A product of expressions with few common symbols is therefore enclosed as a
whole: the box is reduced to the face on which a monotonic function is largest, the face is cut into pieces, and on
each piece both the range and the mean value form,

.. math:: f(x) \in f(m) + f'(X)\,(X - m),

enclose f in floating-point intervals that are rounded outward.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
from dmframe.exact.switching import SWITCHING
from dmframe.program import INPUT, TO_READ, Program, read
from dmframe.prove.definite import Number, upper

MOST: Final = 6
"""Number of symbols with intervals beyond which a product is not enclosed as a whole."""
PIECES: Final = (1, 64, 20, 8, 5, 3, 2)
"""Pieces into which each interval is cut, by the number of symbols in which the product is not monotonic."""


@final
class Box:
    """The intervals of a graph, with upper ends of expressions over them."""

    def __init__(self, numbers: Numbers) -> None:
        self._numbers = numbers
        self._known = dict[int, tuple[Fraction, SX]]()

    def tops(self, expressions: Sequence[SX]) -> list[Fraction]:
        """Upper end of each scalar in parameters and starts, computed once."""
        scalars = [ca.densify(each) for each in expressions]
        new = {each.element_hash(): each for each in scalars if each.element_hash() not in self._known}
        found = map(upper, self._numbers.enclosed(ca.vertcat(ca.SX(0, 1), *new.values())))
        # the kept expressions keep their identities unique
        self._known |= dict(zip(new, zip(found, new.values(), strict=True), strict=True))
        return [self._known[each.element_hash()][0] for each in scalars]

    def tops_of_products(self, first: Sequence[SX], second: Sequence[SX]) -> list[list[Fraction]]:
        """Upper ends of the products of all pairs of scalars, none of which is negative; a row for each of `first`."""
        above = [max(value, Fraction(0)) for value in self.tops([*first, *second])]
        rows, columns = ([*map(self._tied, items)] for items in (first, second))
        return [
            [self._top(one, other, above[k] * above[len(rows) + m]) for m, other in enumerate(columns)]
            for k, one in enumerate(rows)
        ]

    def _top(self, first: _Tied, second: _Tied, apart: Fraction) -> Fraction:
        if not first.open & second.open or len(first.open | second.open) > MOST:
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
        symbols = [self._intervals[key][0] for key in varied]
        used = {symbol.element_hash() for symbol in ca.symvar(expression)}
        closed = [self._values[key] for key in used - set(varied)]
        value = ca.vertcat(expression, ca.gradient(expression, ca.vertcat(*symbols)))
        columns = [ca.vertcat(*symbols), ca.vertcat(ca.SX(0, 1), *(symbol for symbol, _ in closed))]
        exact = [Enclosure.around(upper(each)) for _, each in closed]
        try:
            program = read(ca.Function("product", columns, [value], TO_READ))
            enclosing = Enclosing(program, SWITCHING, lambda number: Enclosure.around(literal(number)))
        except ValueFault:
            return None
        if _is_switched(program):
            return None

        def over(boxes: Sequence[Enclosure]) -> Sequence[Enclosure]:
            return program.dense(enclosing.values([boxes, exact]), Enclosure.of(0.0))[0]

        boxes = _pieces(_pinned([_around(self._intervals[key][1]) for key in varied], over))
        middles = [Enclosure.of((box.lower + box.upper) / 2) for box in boxes]
        wide, near = over(boxes), over(middles)
        mean = near[0]
        for slope, box, middle in zip(wide[1:], boxes, middles, strict=True):
            mean = mean + slope * (box - middle)
        largest = float(np.max(np.minimum(wide[0].upper, mean.upper)))
        return Fraction(largest) if np.isfinite(largest) else None


def _is_switched(program: Program) -> bool:
    """True if an operation other than a smooth one depends on the first argument: slopes do not bound its change."""
    varied = list[bool]()
    for node in program.nodes:
        depends = node.a == 0 if node.code == INPUT else any(varied[k] for k in node.operands)
        if depends and node.code != INPUT and node.code not in RULES:
            return True
        varied.append(depends)
    return False


def _around(interval: Interval) -> Enclosure:
    return Enclosure(Enclosure.around(interval.lower).lower, Enclosure.around(interval.upper).upper)


def _pinned(box: Sequence[Enclosure], over: Callable[[Sequence[Enclosure]], Sequence[Enclosure]]) -> list[Enclosure]:
    """The face of the box on which a function is largest, as far as its slopes have one sign over the box."""
    found, before = list(box), None
    while found != before:
        before = list(found)
        for k, slope in enumerate(over(found)[1:]):
            if slope.lower >= 0:
                found[k] = Enclosure.of(found[k].upper)
            elif slope.upper <= 0:
                found[k] = Enclosure.of(found[k].lower)
    return found


@final
@dataclass(frozen=True, eq=False)
class _Tied:
    """An expression with ratios and factors inserted, and the identities of its symbols with intervals."""

    expression: SX
    open: frozenset[int]


def _pieces(box: Sequence[Enclosure]) -> list[Enclosure]:
    """The box in pieces: for each symbol an array of its intervals on all pieces."""
    moving = sum(bool(each.lower < each.upper) for each in box)
    counts = [PIECES[min(moving, len(PIECES) - 1)] if each.lower < each.upper else 1 for each in box]
    cells = np.array(list(product(*map(range, counts)))).T
    found = []
    for each, count, cell in zip(box, counts, cells, strict=True):
        marks = np.linspace(each.lower, each.upper, count + 1)  # whose first and last are the ends themselves
        found.append(Enclosure(marks[cell], marks[cell + 1]))
    return found
