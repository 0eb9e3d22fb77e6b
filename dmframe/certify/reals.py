"""A second look at a residual that does not vanish in the field: at real points, with so many digits as it takes.

The field knows no function but sin and cos, takes every sign for possible, and reads literals as exact numbers; so a
residual that is not zero there can still be zero at every real point. A claim is called refuted only if some real point
shows it, by more than rounding can explain.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Sequence
from decimal import Decimal
from fractions import Fraction
from typing import final

from dmframe.certify.identity import Equality
from dmframe.certify.symbols import Group, Symbols
from dmframe.exact import Tape
from dmframe.exact.digits import UndefinedHere, at_point, decimal_of
from dmframe.exact.literal import computed

POINTS = 4
"""Points of each kind at which a residual is looked at."""

TRIES = 100
"""Points drawn to find one at which everything is defined."""

VANISHED = Decimal("1e-35")
"""What 60 digits may leave of a residual that is zero, in proportion to its terms."""

NUDGES = 6
"""Times that the computed literals are moved within their rounding."""

FOLDED = 16
"""Operations on literals that may have been carried out, and rounded, while the equations were written."""

BY_A_FUNCTION = (
    "not decided: {of} is what the blocks claim at every real point that was tried, to 35 digits, but only by a "
    "property of a function (tanh, sqrt, sin of a sum) that the exact test does not know, or only away from where a "
    "sign or a comparison switches"
)
BY_ROUNDING = (
    "not decided: {of} differs from what the blocks claim, but by no more than the rounding of numbers in the code "
    "that were computed with before they came into an equation (0.1 + 0.2 is 0.30000000000000004); write 0.3, or make "
    "them parameters"
)
NOWHERE = (
    f"not decided: what the blocks claim has a real value at none of {TRIES} random points; a root, power or logarithm "
    "needs a region that was not found"
)


def doubt(stated: Sequence[Equality], symbols: Symbols, seed: int, of: str = "dV/dt") -> str:
    """Why a claim that fails in the field is not refuted yet; empty where a real point refutes it. `of` names it.

    Points are drawn of both signs, above zero (where roots and powers are real), and with some signals at zero (where
    signs are); one at which something is not defined is drawn again, and is no difference.
    """
    look = _Look(stated, symbols, random.Random(seed))
    reason = ""
    for draw in (look.any_sign, look.positive, look.some_zero):
        for point in look.defined(draw, POINTS):
            found = look.difference(point)
            if found and not look.is_rounding(point):
                return ""
            reason = BY_ROUNDING if found else reason or BY_A_FUNCTION
    return (reason or NOWHERE).format(of=of)


Point = list[list[Decimal]]


@final
class _Look:
    """Residuals and their scales at real points."""

    def __init__(self, stated: Sequence[Equality], symbols: Symbols, rng: random.Random) -> None:
        expressions = [equality.expression for equality in stated] + [equality.scale for equality in stated]
        self._tape = Tape.from_function(symbols.function("residual", expressions))
        self._has_computed = any(map(computed, self._tape.numbers.values()))
        self._groups, self._rng = symbols.groups, rng

    def defined(self, draw: Callable[[Group], list[Decimal]], wanted: int) -> Iterator[Point]:
        """So many points, or fewer, at which everything has a value."""
        for _ in range(TRIES):
            point = [self._values(group, draw) for group in self._groups]
            try:
                at_point(self._tape, point)
            except UndefinedHere:
                continue
            yield point
            wanted -= 1
            if not wanted:
                return

    def _values(self, group: Group, draw: Callable[[Group], list[Decimal]]) -> list[Decimal]:
        if group.values is not None:
            return [decimal_of(value) for value in group.values]
        return self._numbers(group, Decimal("0.5"), 2) if group.kind == "parameter" else draw(group)

    def any_sign(self, group: Group) -> list[Decimal]:
        """Signals between -1.5 and 1.5; parameters are always between 0.5 and 2."""
        return self._numbers(group, Decimal("-1.5"), Decimal("1.5"))

    def positive(self, group: Group) -> list[Decimal]:
        """Signals between 0.1 and 1.5."""
        return self._numbers(group, Decimal("0.1"), Decimal("1.5"))

    def some_zero(self, group: Group) -> list[Decimal]:
        """Each signal zero with probability one half."""
        zero = self._rng.random() < 0.5
        return [Decimal(0)] * group.symbol.numel() if zero else self.any_sign(group)

    def _numbers(self, group: Group, low: Decimal, high: Decimal | int) -> list[Decimal]:
        share = Decimal(2) ** -64
        return [low + (high - low) * self._rng.getrandbits(64) * share for _ in range(group.symbol.numel())]

    def difference(self, point: Point) -> bool:
        """True where some residual is not zero."""
        return any(self._left(at_point(self._tape, point)))

    def is_rounding(self, point: Point) -> bool:
        """True where no residual is larger than what it moves by when computed literals move within their rounding."""
        if not self._has_computed:
            return False
        outputs = at_point(self._tape, point)
        honest, own = self._left(outputs), self._elements(outputs)
        spread = [Decimal(0)] * len(honest)
        for _ in range(NUDGES):
            try:
                moved = self._elements(at_point(self._tape, point, self._nudged()))
            except UndefinedHere:
                continue
            spread = [max(s, abs(a - b)) for s, (a, _), (b, _) in zip(spread, moved, own, strict=True)]
        return all(abs(residual) <= FOLDED * reach for residual, reach in zip(honest, spread, strict=True))

    def _nudged(self) -> Callable[[Fraction], Decimal]:
        """Each computed literal moved by up to half a unit of its last place, the same one by the same amount."""
        moves = dict[Fraction, Decimal]()

        def worth(constant: Fraction) -> Decimal:
            if not computed(constant):
                return decimal_of(constant)
            share = moves.setdefault(constant, Decimal(self._rng.uniform(-1, 1)) * Decimal(2) ** -53)
            return decimal_of(constant) * (1 + share)

        return worth

    def _left(self, outputs: list[list[Decimal]]) -> list[Decimal]:
        """The residuals, those that vanish among their terms as zero."""
        return [
            residual if abs(residual) > VANISHED * scale else Decimal(0) for residual, scale in self._elements(outputs)
        ]

    def _elements(self, outputs: list[list[Decimal]]) -> list[tuple[Decimal, Decimal]]:
        """Each element of a residual, with its scale."""
        half = len(outputs) // 2
        pairs = list[tuple[Decimal, Decimal]]()
        for residuals, scales in zip(outputs[:half], outputs[half:], strict=True):
            pairs += zip(
                residuals, scales if len(scales) == len(residuals) else [max(scales)] * len(residuals), strict=True
            )
        return pairs
