"""Conditions over intervals: separates conditions that fail from those left undecided by wide intervals.

Interval arithmetic ignores that two operands are the same number, so a condition may be met at each point of a box and
undecided for the box. Without intervals this module does nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.certify.checked import Checked, Numbers
from dmframe.certify.claim import Claim
from dmframe.certify.tacit import at_one_point
from dmframe.common.errors import ValueFault
from dmframe.common.text import UNNAMED, Text, joined
from dmframe.exact.balls import UndecidedError
from dmframe.exact.rational import as_float
from dmframe.prove.definite import lower, upper

POINTS: Final = 64
"""Number of points of the box at which an undecided condition is evaluated."""
NEEDED: Final = "over the intervals"


def over_intervals(conditions: Sequence[Checked], claim: Claim, numbers: Numbers) -> list[Checked]:
    """The conditions over the intervals, including those decided at the graph's own numbers only."""
    if not numbers.open:
        return list(conditions)
    known = {item.name for item in conditions}
    more = (item for item in _undecided(claim, numbers) if item.name not in known)
    return [*(_settled(item, numbers) for item in conditions), *more]


def failing_of(conditions: Sequence[Checked]) -> Text:
    """Reason why conditions prevent a proof; empty if all are met."""
    failing = [item for item in conditions if not item.holds]
    open_ = [item for item in failing if NEEDED in item.expression]
    names = joined([item.name for item in failing], "; ")
    if not failing:
        return UNNAMED
    if len(open_) == len(failing):
        return Text(f"the identity holds, but a condition is not decided {NEEDED}: ", names)
    return Text("the identity holds, but a condition fails: ", names)


def _settled(item: Checked, numbers: Numbers) -> Checked:
    margin = item.margin if item.margin is not None else item.reads
    if margin is None or not symbols_in([*numbers.claim.loop.joined([ca.vec(ca.densify(margin))])]) & numbers.open:
        return item
    if item.holds and item.how == "sampled":
        text = Text(item.expression, f"; decided at the graph's own numbers alone, not {NEEDED}")
        return replace(item, holds=False, how="undecided", value=None, expression=text)
    if item.holds or item.how == "undecided" or item.margin is None or _fails(item.margin, item.strict, numbers):
        return item
    text = Text(item.expression, f"; not decided {NEEDED}: it holds at all of {POINTS} points that were tried")
    return replace(item, how="undecided", expression=text)


def _fails(margin: SX, strict: bool, numbers: Numbers) -> bool:
    """True if the margin fails at some point of the box; a margin that cannot be evaluated counts as failing."""
    claim, rng = numbers.claim, np.random.default_rng(0)
    (joined,) = claim.loop.joined([ca.vec(ca.densify(margin))])
    columns = [*(ca.vec(p.symbol) for p in claim.loop.parameters), *(claim.starts[label] for label in numbers.starts)]
    function = ca.Function("margin", columns, [joined], {"allow_free": True})
    if function.has_free():
        return True
    values = [*(numbers.values[p.label] for p in claim.loop.parameters), *numbers.starts.values()]
    low, high = ([np.array([as_float(end(x)) for x in one]) for one in values] for end in (lower, upper))
    for k in range(POINTS):
        # corners first: a monotonic margin is least at a corner
        parts = [rng.integers(0, 2, one.size) if k < POINTS // 2 else rng.uniform(size=one.size) for one in low]
        parts = [np.full(one.size, k) for one in low] if k < 2 else parts
        point = [a + (b - a) * part for a, b, part in zip(low, high, parts, strict=True)]
        least = np.min(function(*point).full(), initial=np.inf)
        if not (least > 0 if strict else least >= 0):
            return True
    return False


def _undecided(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """Conditions without a line in the verdict that are decided at the graph's own numbers only."""
    for item in at_one_point(claim, numbers):
        margin = item.margin
        if item.begun is not None and set(item.begun.symbols) & numbers.starts.keys():
            margin = item.begun.at(numbers.starts)
        read = item.reads if margin is None else margin
        if read is None:
            continue
        (joined,) = claim.loop.joined([ca.vec(ca.densify(read))])
        if symbols_in([joined]) & numbers.open and not (margin is not None and _positive(item, joined, numbers)):
            text = f"not decided {NEEDED}"
            yield Checked(item.name, text, None, False, NEEDED, "undecided", item.strict)


def _positive(item: Checked, margin: SX, numbers: Numbers) -> bool:
    try:
        least = min(map(lower, numbers.enclosed(margin)), default=1)
    except (ValueFault, UndecidedError, OverflowError):
        return False
    return least > 0 if item.strict else least >= 0
