"""Signs of a claim at given parameter values: the weight of each square of V and of the dissipation, exactly."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Final, final

from dmframe.common.errors import ValueFault
from dmframe.exact.ring import evaluated, needed
from dmframe.program import INPUT
from dmframe.prove.claim import Claim, Out, Part
from dmframe.prove.definite import pivots

Numbers = Mapping[str, Sequence[Fraction]]
"""Values of the parameters, by label."""

ROLES: Final = (("stored", "V", True), ("dissipation", "the dissipation", False))
"""Terms whose weights have a sign, the quantity that contains them, and whether the weight must be positive."""


@final
@dataclass(frozen=True)
class Sign:
    """Least element of a weight, or least pivot of a matrix; None if numbers alone do not determine it."""

    name: str
    least: Fraction | None
    strict: bool

    @property
    def holds(self) -> bool | None:
        """Positive, or nonnegative if the condition is not strict."""
        if self.least is None:
            return None
        return self.least > 0 if self.strict else self.least >= 0


def signs(claim: Claim, numbers: Numbers) -> Iterator[Sign]:
    """Signs that the claim requires, of all terms and of the gains and floors of update steps."""
    for part in claim.parts:
        yield from _of_terms(claim, part, numbers)
        for steps in part.steps:
            for name in ("gain", "floor"):
                what = f"{part.block}: {name} of the steps of {steps.estimate}"
                yield Sign(what, _least(claim, steps.parts[name], 0, numbers), strict=True)


def _of_terms(claim: Claim, part: Part, numbers: Numbers) -> Iterator[Sign]:
    for role, where, strict in ROLES:
        for place, term in enumerate(getattr(part, role), start=1):
            name = f"|{term.name}|^2" if term.name else f"term {place}"
            least = None
            if term.rule == "square":
                size = claim.program.outputs[claim.outputs[term.parts["vector"]]].size
                least = _least(claim, term.parts["weight"], size, numbers)
            yield Sign(f"{part.block}: weight of {name} in {where}", least, strict)


def _least(claim: Claim, out: Out, size: int, numbers: Numbers) -> Fraction | None:
    """Least element of the weight of a vector of that size; None if it varies or needs more than + - * /."""
    tape, position = claim.tape, claim.outputs[out]
    places = needed(tape, [position])
    known = {symbol.label: symbol.values or numbers.get(symbol.label) for symbol in claim.symbols}
    read = {tape.nodes[place].a for place in places if tape.nodes[place].code == INPUT}
    if any(known.get(claim.program.inputs[k].name) is None for k in read):
        return None
    inputs = [known.get(each.name) or [Fraction(0)] * each.size for each in claim.program.inputs]
    pattern, sources = claim.program.outputs[position], claim.program.sources[position]
    try:
        values = evaluated(tape, _Rationals(), inputs, places)
    except (ValueFault, ZeroDivisionError):
        return None
    matrix = [Fraction(0)] * pattern.size
    for place, source in zip(pattern.places, sources, strict=True):
        matrix[place] = values[source]
    if size > 1 and len(matrix) == size * size:
        return min(pivots([matrix[k * size : (k + 1) * size] for k in range(size)]))
    return min(matrix)


@final
class _Rationals:
    """The ring of rational numbers, without functions."""

    def number(self, value: Fraction | int) -> Fraction:
        """A number."""
        return Fraction(value)

    def reduced(self, value: Fraction) -> Fraction:
        """The number itself."""
        return value

    def inverse(self, value: Fraction) -> Fraction:
        """1 / value."""
        return 1 / value

    def power(self, value: Fraction, exponent: int) -> Fraction:
        """An integer power."""
        return value**exponent

    def call(self, name: str, *arguments: Any) -> Fraction:
        """Raise `ValueFault`: no function has an exact value."""
        raise ValueFault(f"a sign: expected + - * and /, found {name}")
