"""Algebra of dimensions with unknowns: products, and linear equations from sums."""

from __future__ import annotations

from collections import defaultdict
from fractions import Fraction
from typing import Final, final

from dmframe.dimensions.dimension import BASES, NUMBER, ONE, Dimension, Power, product

ANYTHING: Final = 0
"""The handle of zero, which has any dimension."""


@final
class Algebra:
    """Dimensions by integer handles, so that each product of two is computed once.

    Unknowns are determined by elimination: an equation with an unknown sets it; an equation without one that does not
    hold is a contradiction.

    Attributes
    ----------
    ignored
        Base units whose powers are not compared. It is set before the first comparison, which is remembered.
    """

    def __init__(self) -> None:
        self.ignored: tuple[str, ...] = ()
        self._known: list[Dimension] = [ONE]  # the entry of zero, which is never read
        self._handles: dict[Dimension, int] = {}
        self._products: dict[tuple[int, int, Power], int] = {}
        self._solved: dict[int, Dimension] = {}
        self._resolved: dict[int, int] = {}
        self._holding = defaultdict[int, set[int]](set)
        self._compared: dict[tuple[int, int], bool | None] = {}
        self._count = 0
        self.number = self.handle(NUMBER)

    def handle(self, dimension: Dimension) -> int:
        """The handle of a dimension."""
        found = self._handles.get(dimension)
        if found is None:
            found = self._handles[dimension] = len(self._known)
            self._known.append(dimension)
        return found

    def unknown(self) -> int:
        """A new unknown."""
        self._count += 1
        return self.handle(ONE._replace(unknowns=((self._count, 1),)))

    def product(self, one: int, other: int, power: Power = 1) -> int:
        """One * other^power; zero if either is zero."""
        if not one or not other:
            return ANYTHING
        key = (self._resolved.get(one, one), self._resolved.get(other, other), power)
        found = self._products.get(key)
        if found is None:
            found = self._products[key] = self.handle(product(self._known[key[0]], self._known[key[1]], power))
        return found

    def same(self, one: int, other: int) -> int | None:
        """The common dimension, which sets unknowns; None if the dimensions contradict each other."""
        if one == other or not other:
            return one
        if not one:
            return other
        key = one, other = self._resolve(one), self._resolve(other)
        if one == other:
            return one
        if key not in self._compared:
            a, b = self._known[one], self._known[other]
            ratio = product(a, b, -1)
            if ratio.unknowns:
                self._solve(ratio, exact=ratio.angular and not a.number and not b.number)
                return one if _sharper(self.of(one), self.of(other)) else other
            self._compared[key] = _sharper(a, b) if self._equal(a, b, ratio) else None
        first = self._compared[key]
        return None if first is None else one if first else other

    def _equal(self, a: Dimension, b: Dimension, ratio: Dimension) -> bool:
        """True for two dimensions, whose ratio has no unknowns, that a sum may have."""
        *powers, angles = ((base not in self.ignored) * power for base, power in zip(BASES, ratio.powers, strict=True))
        if b.number:
            angles -= angles == 1  # a literal number may be in radians
        elif a.number:
            angles += angles == -1
        return not any(powers) and not (ratio.angular and angles)

    def forget(self) -> None:
        """Reset all unknowns."""
        self._solved.clear()
        self._resolved.clear()
        self._holding.clear()

    def of(self, handle: int) -> Dimension:
        """The dimension, with the unknowns that have been determined."""
        return self._known[self._resolve(handle)]

    def _solve(self, ratio: Dimension, *, exact: bool) -> None:
        """Set the newest unknown so that the equation is satisfied."""
        key, power = ratio.unknowns[-1]
        rest = ratio._replace(unknowns=ratio.unknowns[:-1], angular=exact, number=False)
        value = product(ONE, rest, -power if power in (1, -1) else Fraction(-1) / power)
        for other, known in self._solved.items():
            for held, exponent in known.unknowns:
                if held == key:
                    left = tuple(pair for pair in known.unknowns if pair[0] != key)
                    self._solved[other] = product(known._replace(unknowns=left), value, exponent)
        self._solved[key] = value
        for handle in self._holding.pop(key, ()):
            self._resolved.pop(handle, None)

    def _resolve(self, handle: int) -> int:
        found = self._resolved.get(handle)
        if found is None:
            dimension = self._known[handle]
            whole = dimension
            if any(key in self._solved for key, _ in dimension.unknowns):
                left = tuple(pair for pair in dimension.unknowns if pair[0] not in self._solved)
                whole = dimension._replace(unknowns=left)
                for key, exponent in dimension.unknowns:
                    if key in self._solved:
                        whole = product(whole, self._solved[key], exponent)
            found = self._resolved[handle] = self.handle(whole)
            for key, _ in whole.unknowns:
                self._holding[key].add(handle)
        return found


def _sharper(a: Dimension, b: Dimension) -> bool:
    """True where the first of two equal dimensions is known as completely as the other."""
    return (not a.number, a.angular) >= (not b.number, b.angular)
