"""Range of an expression with any operations over intervals of its symbols.

256-bit balls lose no accuracy by cancellation, but their ends are not sharp: the square of [-1, 1] is at best a ball of
radius 1 about 0.5. Intervals of floats have sharp ends and few digits. The range is the intersection of both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction

import numpy as np
from flint import arb

from dmframe.common.errors import ValueFault
from dmframe.exact.balls import ZERO, UndecidedError, above, ball, below, enclosed, precise
from dmframe.exact.enclosure import Enclosing, Enclosure
from dmframe.exact.literal import literal
from dmframe.exact.rational import Interval
from dmframe.exact.switching import SWITCHING
from dmframe.program import Program

Given = Sequence[Sequence[Fraction | Interval]]
Ends = list[tuple[float, float]]


def ranges(program: Program, inputs: Given) -> list[Interval]:
    """Ranges of the elements of a program's first output; an input is a list of its stored elements.

    Raises `UndecidedError` if a bound cannot be computed or an operation has no rule.
    """
    wide = any(isinstance(value, Interval) for column in inputs for value in column)
    methods: list[Callable[[Program, Given], Ends]] = [_in_balls, *[_in_floats] * wide]
    found, reasons = list[Ends](), list[str]()
    for method in methods:
        try:
            found.append(method(program, inputs))
        except (ValueFault, UndecidedError) as error:
            reasons.append(error.text)
    if not found:
        raise UndecidedError(reasons[0])
    ends = [(max(lower for lower, _ in one), min(upper for _, upper in one)) for one in zip(*found, strict=True)]
    if not np.all(np.isfinite(ends)):
        raise UndecidedError("a number is too large")
    return [Interval(Fraction(lower), Fraction(upper)) for lower, upper in ends]


@precise()
def _in_balls(program: Program, inputs: Given) -> Ends:
    values = enclosed(program, [[_ball(value) for value in column] for column in inputs])
    return [(below(value), above(value)) for value in program.dense(values, ZERO)[0]]


def _in_floats(program: Program, inputs: Given) -> Ends:
    enclosing = Enclosing(program, SWITCHING, lambda value: Enclosure.around(literal(value)))
    values = enclosing.values([[_box(value) for value in column] for column in inputs])
    ends = [(float(value.lower), float(value.upper)) for value in program.dense(values, Enclosure.of(0.0))[0]]
    if np.any(np.isnan(ends)):
        raise UndecidedError("an operation is not defined on its whole interval")
    return ends


def _ball(value: Fraction | Interval) -> arb:
    return ball(value.lower).union(ball(value.upper)) if isinstance(value, Interval) else ball(value)


def _box(value: Fraction | Interval) -> Enclosure:
    ends = Interval.of(value)
    return Enclosure(Enclosure.around(ends.lower).lower, Enclosure.around(ends.upper).upper)


__all__ = ["ranges"]
