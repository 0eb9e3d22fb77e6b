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
class InjectedFault:
    """A seeded fault, and whether the test refuted it."""

    fault: Text
    refuted: bool


def inject_faults(claim: Claim, *, seed: int) -> tuple[InjectedFault, ...]:
    """Seed faults that the exact test must refute.

    They are: each state's rate or increment reversed, each term dropped, each gain changed in the equations only.

    A fault changes the rates or next values, and D V is recomputed; a dropped term is removed from the sum. A term
    that is identically zero (friction that the plant does not have) and a gain that V does not contain are no faults.
    Neither is a gain that does not affect the moves of any state in V, such as that of a regressor that is zero for
    this robot. This is decided from the moves, never from the residual: if a move changes and the residual does not,
    the fault counts as missed.
    """
    faults = _Faults(claim.shared, random.Random(seed + 1))
    return (*faults.reversed(), *faults.dropped(), *faults.changed())


@final
class _Faults:
    """One random point of a random prime field at which the faults are injected one after the other."""

    def __init__(self, claim: Claim, rng: random.Random) -> None:
        self._claim = claim
        for _ in range(ATTEMPTS):
            self._trial = Trial(random_prime(rng, BITS), rng)
            try:
                inputs = inputs_at(claim, self._trial)
                self._evaluation = Evaluation(claim.tape, inputs, self._trial, claim.copies.values())
                self._point = Point(claim, self._trial, inputs, self._evaluation.values)
                self._moves = self._point.moves(claim.moves)
                self._unchanged = self._compared(self._moves)
            except ZeroDivision:
                continue
            return
        raise ValueFault(
            "fault injection: a denominator vanishes at every random point; expected defined rates, also of states  "
            "that V does not contain"
        )

    def reversed(self) -> Iterator[InjectedFault]:
        """Each state's rate or increment reversed."""
        claim = self._claim
        for label in claim.reversed:
            if self._matters(label):
                moves = self._moves | self._point.moves({label: claim.moves[label]}, [label])
                name = Text("sign of ", Label(f"d {label}/dt"), " flipped")
                if claim.over_samples:
                    name = Text(Label(label), ": increment reversed")
                yield InjectedFault(name, self._refuted(moves))

    def _matters(self, label: str) -> bool:
        """True if the move of a state changes V; in discrete time, if the state moves."""
        if self._claim.over_samples:
            before = self._point.input(label)
            return self._nonzero(then - x for x, then in zip(before, self._moves[label], strict=True))
        return self._nonzero(_storage_rate(self._compared({label: self._moves[label]})))

    def dropped(self) -> Iterator[InjectedFault]:
        """Each term dropped."""
        for equality in self._unchanged:
            for summand in equality.summands:
                if summand.name and self._nonzero(summand.column):
                    rest = [a - b for a, b in zip(equality.sums, summand.column, strict=True)]
                    yield InjectedFault(summand.name, self._nonzero(rest))

    def changed(self) -> Iterator[InjectedFault]:
        """Each gain changed in the rates or next values."""
        claim = self._claim
        for label, place in claim.copies.items():
            others = [self._trial.random() for _ in self._point.input(label)]
            values = self._evaluation.changed({place: others})
            moves = Point(claim, self._trial, self._point.inputs, values).moves(claim.moves)
            if any(self._nonzero(a - b for a, b in zip(moves[at], self._moves[at], strict=True)) for at in claim.moves):
                yield InjectedFault(Text(Label(label), " changed in the equations only"), self._refuted(moves))

    def _compared(self, moves: Mapping[str, Sequence[Any]]) -> list[Equality]:
        """Equalities that a fault may violate: D V of the diagram, or all of a sample's."""
        if self._claim.over_samples:
            return list(equalities(self._point, moves))
        return [next(equalities(self._point, moves))]

    def _refuted(self, moves: Mapping[str, Sequence[Any]]) -> bool:
        return any(self._nonzero(equality.sums) for equality in self._compared(moves))

    def _nonzero(self, numbers: Any) -> bool:
        return any(x % self._trial.prime for x in numbers)


def _storage_rate(found: Sequence[Equality]) -> list[Any]:
    return [sum(sum(s.column) for s in found[0].summands if ": storage of " in s.name)]
