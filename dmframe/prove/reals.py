"""Numeric cross-check of a residual that does not vanish in the field: evaluation at real points in ball arithmetic.

A prime field has no functions except sin and cos, admits every choice of signs, and reads literals as exact numbers. A
residual that is nonzero there may therefore be zero at every real point. A claim is called refuted only if the residual
is proved to be nonzero at some real point, by more than the rounding of literals can explain.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Final, final

from flint import arb

from dmframe.common.text import DV, UNNAMED, Piece, Text, sentence
from dmframe.exact.balls import ONE, RULES, ZERO, UndecidedError, ball, precise
from dmframe.exact.literal import computed
from dmframe.exact.ring import evaluated
from dmframe.program import BY_NAME
from dmframe.prove.claim import Claim, Symbol
from dmframe.prove.point import Point, equalities

POINTS = 4
"""Number of points of each kind at which a residual is evaluated."""

ZERO_POINTS = 16
"""Number of points with some zero signals: at a quarter of them, two given signals are zero and nonzero."""

TRIES = 100
"""Maximum number of points drawn to find one at which everything is defined."""

VANISHED: Final = 1e-35
"""Largest residual, relative to its terms, that counts as zero."""

NUDGES = 6
"""Number of times that the computed literals are perturbed within their rounding."""

FOLDED = 16
"""Largest number of operations on literals that may have been carried out, and rounded, before an equation."""

BY_A_FUNCTION = (
    "not decided: {of} equals what the blocks claim at every real point that was tried, to 35 digits. The equality may "
    "depend on a property of a function (tanh, sqrt, sin of a sum) that the exact test does not use, or it may fail "
    "where a sign or a comparison switches"
)
BY_ROUNDING = (
    "not decided: {of} differs from what the blocks claim, but by no more than the rounding of numbers that Python "
    "combined before they entered an equation (0.1 + 0.2 is 0.30000000000000004); write 0.3, or make them parameters"
)
NOWHERE = (
    f"not decided: what the blocks claim is undefined at all of {TRIES} random real points; a root, power or logarithm "
    "requires a region that was not found"
)


@precise()
def why_not_refuted(claim: Claim, seed: int, of: Piece = DV) -> Text:
    """Reason why a claim that fails in the field is not refuted; empty if a real point refutes it.

    `of` is the name of the claim in the text.

    Points have both signs, only positive values (for roots and powers), or some zero signals (for signs). A point at
    which something is undefined is replaced by another one, and is not counted as a difference.
    signs are); one at which something is not defined is drawn again, and is no difference.
    """
    points = _RealPoints(claim, random.Random(seed))
    reason = ""
    for draw, count in ((points.any_sign, POINTS), (points.positive, POINTS), (points.some_zero, ZERO_POINTS)):
        for point, residuals in points.defined(draw, count):
            differs = not all(residual.is_zero() for residual in residuals)
            if differs and not points.is_rounding(point, residuals):
                return UNNAMED
            reason = BY_ROUNDING if differs else reason or BY_A_FUNCTION
    return sentence(reason or NOWHERE, of=of)


Numbers = list[list[arb]]


@final
class Balls:
    """The ring of real balls; an undefined operation gives NaN, and so does every value that depends on it.

    One object represents one number, and is therefore equal to itself although its ball has a width, for example in a
    comparison of a point in a box with its projection onto the box.

    Parameters
    ----------
    number
        Ball of an exact number.
    """

    def __init__(self, number: Callable[[Fraction], arb] = ball) -> None:
        self._number = number

    def number(self, value: Fraction | int) -> arb:
        """Ball of an exact number."""
        return self._number(Fraction(value))

    def reduced(self, value: arb) -> arb:
        """The ball itself."""
        return value

    def inverse(self, value: arb) -> arb:
        """1 / value."""
        return ONE / value

    def power(self, value: arb, exponent: int) -> arb:
        """An integer power."""
        return value**exponent

    def call(self, name: str, *arguments: arb) -> arb:
        """Value of a function; the minimum or maximum of two numbers is one of the two objects."""
        operands = [each if isinstance(each, arb) else arb(each) for each in arguments]
        if name in _ORDERED and (chosen := _ORDERED[name](*operands)) is not None:
            return chosen
        if name in _OF_ITSELF and operands[0] is operands[1] and operands[0].is_finite():
            return _OF_ITSELF[name]
        found: arb = RULES[BY_NAME[name].code](*operands)
        return found


_ORDERED: Final[Mapping[str, Callable[[arb, arb], arb | None]]] = {
    "fmin": lambda a, b: a if a < b else b if b < a else None,
    "fmax": lambda a, b: a if a > b else b if b > a else None,
}
_OF_ITSELF: Final = {"eq": ONE, "le": ONE, "ne": ZERO, "lt": ZERO}


@final
class _RealPoints:
    """Residuals and their scales at real points."""

    def __init__(self, claim: Claim, rng: random.Random) -> None:
        self._claim, self._rng = claim, rng
        self._has_computed = any(map(computed, claim.tape.numbers.values()))

    def defined(self, draw: Callable[[Symbol], list[arb]], count: int) -> Iterator[tuple[Numbers, list[arb]]]:
        """At most `count` points at which everything is defined, with the residuals; negligible residuals are zero."""
        for _ in range(TRIES):
            point = [self._drawn(group, draw) for group in self._claim.symbols]
            try:
                found = self._residuals(self._elements(point))
            except UndecidedError:
                continue
            yield point, found
            count -= 1
            if not count:
                return

    def _drawn(self, group: Symbol, draw: Callable[[Symbol], list[arb]]) -> list[arb]:
        if group.values is not None:
            return [ball(value) for value in group.values]
        return self._numbers(group, Fraction(1, 2), Fraction(2)) if group.kind == "parameter" else draw(group)

    def any_sign(self, group: Symbol) -> list[arb]:
        """Signals between -1.5 and 1.5; parameters are always between 0.5 and 2."""
        return self._numbers(group, Fraction(-3, 2), Fraction(3, 2))

    def positive(self, group: Symbol) -> list[arb]:
        """Signals between 0.1 and 1.5."""
        return self._numbers(group, Fraction(1, 10), Fraction(3, 2))

    def some_zero(self, group: Symbol) -> list[arb]:
        """Each signal zero with probability one half."""
        zero = self._rng.random() < 0.5
        return [ZERO] * group.size if zero else self.any_sign(group)

    def _numbers(self, group: Symbol, low: Fraction, high: Fraction) -> list[arb]:
        steps = (self._rng.getrandbits(64) for _ in range(group.size))
        return [ball(low + (high - low) * Fraction(step, 2**64)) for step in steps]

    def is_rounding(self, point: Numbers, residuals: Sequence[arb]) -> bool:
        """True if no residual exceeds its change when computed literals are perturbed within their rounding."""
        if not self._has_computed:
            return False
        own, spread = self._elements(point), [ZERO] * len(residuals)
        for _ in range(NUDGES):
            try:
                moved = self._elements(point, self._nudged())
            except UndecidedError:
                continue
            spread = [max(s, (a - b).abs_upper()) for s, (a, _), (b, _) in zip(spread, moved, own, strict=True)]
        return all(abs(residual) <= FOLDED * reach for residual, reach in zip(residuals, spread, strict=True))

    def _nudged(self) -> Callable[[Fraction], arb]:
        """Each computed literal perturbed by up to half a unit in the last place; equal literals by the same amount."""
        moves = dict[Fraction, float]()

        def moved(number: Fraction) -> arb:
            if not computed(number):
                return ball(number)
            fraction = moves.setdefault(number, self._rng.uniform(-1, 1))
            return ball(number) * (1 + fraction * arb((1, -53)))

        return moved

    @staticmethod
    def _residuals(elements: Sequence[tuple[arb, arb]]) -> list[arb]:
        """The residuals; those that are negligible compared with their terms are zero. Raises `UndecidedError`."""
        found = list[arb]()
        for residual, scale in elements:
            vanishes = abs(residual) <= VANISHED * scale
            if not vanishes and not abs(residual) > VANISHED * scale:
                raise UndecidedError("the enclosure of a residual is too wide")
            found.append(ZERO if vanishes else residual)
        return found

    def _elements(self, point: Numbers, number: Callable[[Fraction], arb] = ball) -> list[tuple[arb, arb]]:
        """Each element of a residual, with the sum of the absolute values of its terms."""
        claim = self._claim
        inputs = [*point, *(point[claim.inputs[label]] for label in claim.gains)]
        ring = Balls(number)
        at = Point(claim, ring, inputs, evaluated(claim.tape, ring, inputs, claim.places))
        pairs = list[tuple[arb, arb]]()
        for equality in equalities(at, at.moves(claim.moved)):
            terms = [list(map(arb, row)) for row in zip(*(s.column for s in equality.summands), strict=True)]
            scales = [sum(map(abs, row), ZERO) for row in terms]
            pairs += zip((sum(row, ZERO) for row in terms), scales, strict=True)
        if not all(scale.is_finite() for _, scale in pairs):
            raise UndecidedError("a residual is not defined on a whole ball")
        return pairs
