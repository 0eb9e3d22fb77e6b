"""Fault injection: faults seeded into a claim, each of which the exact test must refute."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

from dmframe.common.errors import ValueFault
from dmframe.common.text import Label, Text
from dmframe.exact import Evaluation, Trial, ZeroDivision, random_prime
from dmframe.prove.claim import Claim
from dmframe.prove.identity import ATTEMPTS, BITS, inputs_at
from dmframe.prove.point import Equality, Point, equalities


@final
@dataclass(frozen=True)
class Control:
    """A seeded fault, and whether the test refuted it."""

    fault: Text
    refuted: bool


def inject_faults(claim: Claim, *, seed: int) -> tuple[Control, ...]:
    """Seed faults that the identity must refute: each state's move reversed, each term dropped, each gain changed in
    the equations only.

    A fault changes what moves the states, and D V is formed anew; a term is dropped from the sum. A term that is
    identically zero (friction that the plant does not have) and a gain that V does not hold are no faults; nor is a
    gain whose change leaves the moves of all that V holds as they are, identically, such as that of a regressor that is
    zero for this robot. This is read from the moves, never from the residual: a change of the moves that the residual
    does not show is a fault that was missed.
    """
    faults = _Faults(claim.shared, random.Random(seed + 1))
    return (*faults.reversed(), *faults.dropped(), *faults.changed())


@final
class _Faults:
    """One random point of a random prime field, at which one fault after the other is put in."""

    def __init__(self, claim: Claim, rng: random.Random) -> None:
        self._claim = claim
        for _ in range(ATTEMPTS):
            self._trial = Trial(random_prime(rng, BITS), rng)
            try:
                inputs = inputs_at(claim, self._trial)
                self._evaluation = Evaluation(claim.tape, inputs, self._trial, claim.copies.values())
                self._point = Point(claim, self._trial, inputs, self._evaluation.values)
                self._moves = self._point.moves(claim.moves)
                self._honest = self._compared(self._moves)
            except ZeroDivision:
                continue
            return
        raise ValueFault(
            "fault injection: a denominator vanishes at every random point; expected moves that are defined, of what V "
            "does not hold too"
        )

    def reversed(self) -> Iterator[Control]:
        """Each state's move reversed."""
        claim = self._claim
        for label in claim.reversed:
            if self._matters(label):
                moves = self._moves | self._point.moves({label: claim.moves[label]}, [label])
                name = Text("sign of ", Label(f"d {label}/dt"), " flipped")
                if claim.over_samples:
                    name = Text(Label(label), ": its move reversed")
                yield Control(name, self._refuted(moves))

    def _matters(self, label: str) -> bool:
        """True where the move of a state changes V; over samples, where there is one."""
        if self._claim.over_samples:
            before = self._point.input(label)
            return self._some(then - x for x, then in zip(before, self._moves[label], strict=True))
        return self._some(_storage_rate(self._compared({label: self._moves[label]})))

    def dropped(self) -> Iterator[Control]:
        """Each term dropped."""
        for equality in self._honest:
            for summand in equality.summands:
                if summand.name and self._some(summand.column):
                    left = [a - b for a, b in zip(equality.sums, summand.column, strict=True)]
                    yield Control(summand.name, self._some(left))

    def changed(self) -> Iterator[Control]:
        """Each gain changed in what moves the states."""
        claim = self._claim
        for label, place in claim.copies.items():
            others = [self._trial.random() for _ in self._point.input(label)]
            values = self._evaluation.changed({place: others})
            moves = Point(claim, self._trial, self._point.inputs, values).moves(claim.moves)
            if any(self._some(a - b for a, b in zip(moves[at], self._moves[at], strict=True)) for at in claim.moves):
                yield Control(Text(Label(label), " changed in the equations only"), self._refuted(moves))

    def _compared(self, moves: Mapping[str, Sequence[Any]]) -> list[Equality]:
        """The equalities that a fault may break: D V of the diagram, or all of a sample's."""
        if self._claim.over_samples:
            return list(equalities(self._point, moves))
        return [next(equalities(self._point, moves))]

    def _refuted(self, moves: Mapping[str, Sequence[Any]]) -> bool:
        return any(self._some(equality.sums) for equality in self._compared(moves))

    def _some(self, numbers: Any) -> bool:
        return any(x % self._trial.prime for x in numbers)


def _storage_rate(found: Sequence[Equality]) -> list[Any]:
    return [sum(sum(s.column) for s in found[0].summands if ": storage of " in s.name)]
