r"""Exact linear combinations in a program: rational factors times powers of the period T.

Used to find cancelling terms, and invariant sums of states such as the difference of two integrals of one command.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Final, final

from dmframe.exact.literal import literal
from dmframe.program import CONST, INPUT, Node, by_code

Term = tuple[int, int]
"""Index of a value in a program, and the power of T that multiplies it."""

Sum = dict[Term, Fraction]

PERIOD: Final = 2
"""Index of T among the program's arguments."""

_NAMED: Final = by_code({name: name for name in ("add", "sub", "neg", "twice", "mul", "div")})


def sums_of(nodes: Sequence[Node], whole: Sequence[bool] = (), *, inputs_alone: bool = False) -> list[Sum | None]:
    """Each value as a linear combination of inputs and of values that are no sums, or are `whole`.

    With `inputs_alone`, None for values that are not combinations of inputs.
    """
    found, factors, first = list[Sum | None](), list[tuple[Fraction, int] | None](), dict[tuple[int, int], int]()
    for place, (code, a, b, constant, _) in enumerate(nodes):
        name, factor = _NAMED.get(code), None
        own: Sum | None = None if inputs_alone else {(place, 0): Fraction(1)}
        if code == INPUT:
            own = {(first.setdefault((a, b), place), 0): Fraction(1)}
            factor = (Fraction(1), 1) if a == PERIOD else None
        elif code == CONST:
            factor = literal(constant), 0
            own = {} if constant == 0 else own
        elif name in ("neg", "twice"):
            times = Fraction(-1 if name == "neg" else 2)
            own, factor = scaled(found[a], times, 0, own), _times(factors[a], (times, 0))
        elif name in ("add", "sub"):
            one, other = found[a], found[b]
            if one is not None and other is not None:
                own = added(one, other, Fraction(1 if name == "add" else -1))
        elif name == "mul":
            factor = _times(factors[a], factors[b])
            for known, of in ((factors[a], b), (factors[b], a)):
                if known is not None:
                    own = scaled(found[of], *known, own)
                    break
        elif name == "div" and (known := factors[b]) is not None and known[0]:
            under = 1 / known[0], -known[1]
            factor, own = _times(factors[a], under), scaled(found[a], *under, own)
        found.append({(place, 0): Fraction(1)} if whole and whole[place] and code != INPUT else own)
        factors.append(factor)
    return found


def scaled(one: Sum | None, times: Fraction, power: int, otherwise: Sum | None = None) -> Sum | None:
    """Sum times a number and a power of T; `otherwise` if there is no sum."""
    if one is None:
        return otherwise
    return {(place, k + power): times * value for (place, k), value in one.items() if times}


def added(one: Mapping[Term, Fraction], other: Mapping[Term, Fraction], factor: Fraction) -> Sum:
    """Sum plus a factor times another, without cancelled terms."""
    found = dict(one)
    for key, value in other.items():
        new = found.get(key, Fraction(0)) + factor * value
        if new:
            found[key] = new
        else:
            found.pop(key, None)
    return found


def _times(one: tuple[Fraction, int] | None, other: tuple[Fraction, int] | None) -> tuple[Fraction, int] | None:
    return None if one is None or other is None else (one[0] * other[0], one[1] + other[1])


@final
class Span:
    """Linear span of sums over the rational numbers."""

    def __init__(self) -> None:
        self._rows = dict[Term, tuple[Sum, Sum]]()  # by leading term: the reduced sum and its combination

    def add(self, one: Sum, name: Term) -> Sum | None:
        """Add a sum; returns the linear relation, factors by name, if it depends on the others."""
        left, made = self._reduced(one, {name: Fraction(1)})
        if not left:
            return made
        self._rows[min(left)] = left, made
        return None

    def factors(self, one: Sum) -> Sum | None:
        """Factors by name of a sum as a combination of the others; None if it is independent."""
        left, made = self._reduced(one, {})
        return None if left else {key: -value for key, value in made.items()}

    def _reduced(self, one: Sum, made: Sum) -> tuple[Sum, Sum]:
        while leading := self._rows.keys() & one.keys():
            key = min(leading)  # its row adds later terms only
            row, of = self._rows[key]
            factor = -one[key] / row[key]
            one, made = added(one, row, factor), added(made, of, factor)
        return one, made


def conserved(moves: Mapping[int, Sum]) -> list[Sum]:
    """Linear invariants: constant sums of states; the first state of each occurs in no other sum.

    Returns the factors by state and power of T, one for the first state.

    Parameters
    ----------
    moves
        Change of each state in a sample, as a sum.
    """
    active = {state: one for state, one in moves.items() if one}
    while True:  # a term in the change of a single state never cancels
        uses = dict[int, int]()
        for one in active.values():
            for place in {place for place, _ in one}:
                uses[place] = uses.get(place, 0) + 1
        left = {state: one for state, one in active.items() if all(uses[place] > 1 for place, _ in one)}
        if len(left) == len(active):
            break
        active = left
    span, relations = Span(), list[Sum]()
    for power in (0, 1):  # of T, in the factors of a conserved sum
        for state, one in active.items():
            relation = span.add(scaled(one, Fraction(1), power) or {}, (state, power))
            if relation is not None:
                relations.append(relation)
    return _each_with_its_own(relations)


def _each_with_its_own(relations: Sequence[Sum]) -> list[Sum]:
    """Relations with a state, of a factor independent of T, that occurs in no other relation."""
    found = list[Sum]()
    for relation in relations:
        taken = {next(iter(other))[0] for other in found}
        powers = dict[int, set[int]]()
        for state, power in relation:
            powers.setdefault(state, set()).add(power)
        own = [s for s, p in powers.items() if p == {0} and not any(s in {k for k, _ in other} for other in found)]
        if own and not taken & powers.keys():
            first = own[0], 0
            found.append({first: Fraction(1)} | {k: v / relation[first] for k, v in relation.items() if k != first})
    return found


__all__ = ["PERIOD", "Span", "Sum", "Term", "added", "conserved", "scaled", "sums_of"]
