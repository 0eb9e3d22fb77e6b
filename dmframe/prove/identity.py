"""The exact test of a claim: each equality vanishes at random points of random prime fields."""

from __future__ import annotations

import math
import random
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, Final, final

from dmframe.common.errors import ValueFault
from dmframe.exact import Evaluation, Trial, Witness, ZeroDivision, ZeroTest, random_prime
from dmframe.exact.identity import log2_error
from dmframe.exact.ring import evaluated
from dmframe.exact.sizes import Bound, Sizes
from dmframe.prove.claim import Claim, Symbol
from dmframe.prove.point import Equality, Point, differences, equalities

ATTEMPTS: Final = 20
"""Maximum number of random points tried until no denominator vanishes."""

MOST_LOG2_ERROR: Final = -64
"""Largest log2 of the error bound of one point for which an identity counts as decided."""

BITS: Final = 149
"""Bits of the random primes; like 127 bits they need five digits of Python's integers, so the speed is the same."""

MORE_BITS: Final = (269, 521)
"""Bits of the primes for claims whose degree is too high for `BITS`, such as least squares with many columns."""


def residues(trial: Trial, symbol: Symbol, values: Mapping[str, Sequence[Fraction]] | None = None) -> list[int]:
    """Residues of a symbol: its exact values, the values given by label, or random ones."""
    known = (values or {}).get(symbol.label, symbol.values)
    if known is None:
        return [trial.random() for _ in range(symbol.size)]
    return [trial.residue(value) for value in known]


def inputs_at(claim: Claim, trial: Trial, values: Mapping[str, Sequence[Fraction]] | None = None) -> list[list[int]]:
    """Residues of all inputs; the copies of gains equal the gains."""
    own = {symbol.label: residues(trial, symbol, values) for symbol in claim.symbols}
    return [*own.values(), *(own[label] for label in claim.gains)]


def over_signs(
    claim: Claim, inputs: Sequence[Sequence[int]], trial: Trial, only: str = ""
) -> Iterator[list[tuple[Equality, list[int]]]]:
    """Each equality, or the one with a given label, and its sums, for every choice of signs.

    The error bound of a trial requires all choices. Where a sign is 0, its argument is 0, and |x| can be evaluated as 0
    or as x: an element that vanishes in one of these evaluations is returned as zero.
    """
    evaluation, known = Evaluation(claim.tape, inputs, trial, (), claim.places), dict[Any, Any]()

    def sums() -> list[tuple[Equality, list[int]]]:
        point = Point(claim, trial, inputs, evaluation.values, known)
        return [
            (equality, [x % trial.prime for x in equality.sums])
            for equality in equalities(point, point.moves(claim.moved))
            if only in ("", equality.label)
        ]

    found = sums()
    while True:
        if trial.on_a_jump and any(any(values) for _, values in found):
            trial.fabs_is_argument_at_zero = True
            evaluation.recompute_signs()
            others = sums()
            trial.fabs_is_argument_at_zero = False
            found = [
                (equality, [a and b and a for a, b in zip(one, other, strict=True)])
                for (equality, one), (_, other) in zip(found, others, strict=True)
            ]
        yield found
        if not trial.next_signs():
            return
        evaluation.recompute_signs()
        found = sums()


def bound_of(claim: Claim) -> Bound:
    """Quantities that determine the probability of a wrong result."""
    ring = Sizes()
    fixed = {place: symbol.values for place, symbol in enumerate(claim.symbols) if symbol.values is not None}
    inputs = ring.inputs(claim.tape, fixed)
    for label, place in claim.copies.items():
        inputs[place] = inputs[claim.inputs[label]]
    point = Point(claim, ring, inputs, evaluated(claim.tape, ring, inputs, claim.places))
    sums = (size for equality in equalities(point, point.moves(claim.moved)) for size in equality.sums)
    return ring.bound(size for size in sums if not isinstance(size, int))


@final
@dataclass(frozen=True)
class Points:
    """Independent random points of `identity`.

    Parameters
    ----------
    bits
        Bits of the primes.
    error
        log2 of the error bound of one point.
    """

    claim: Claim
    seed: int
    bits: int
    error: float
    degree: int

    @classmethod
    def of(cls, claim: Claim, *, seed: int) -> Points:
        """The points of a claim. Raises `ValueFault` if the error bound of one exceeds 2**`MOST_LOG2_ERROR`."""
        bound = bound_of(claim)
        bits = next((bits for bits in (BITS, *MORE_BITS) if log2_error(bound, 0, bits, False) <= MOST_LOG2_ERROR), BITS)
        error = log2_error(bound, 0, bits, False)
        if error > MOST_LOG2_ERROR:
            raise ValueFault(
                f"the exact test: at one point a false identity may pass with a probability of up to 2^{error:.0f}; "
                f"expected at most 2^{MOST_LOG2_ERROR}: the degree of the claim is too high"
            )
        return cls(claim, seed, bits, error, bound.degree_total)

    def at(self, place: int) -> ZeroTest:
        """The test at one point. Raises `ValueFault` if the claim is undefined at every random point."""
        prime, witness = _trial(self.claim.shared, random.Random(f"{self.seed}:{place}"), self.bits)
        error = self.error if witness is None else -math.inf
        return ZeroTest(witness is None, 1, (prime,), self.degree, error, witness, self.seed)


def identity(claim: Claim, *, trials: int, seed: int) -> ZeroTest:
    """Decide whether every equality of a claim vanishes identically; see `dmframe.exact.zero_test`.

    Raises `ValueFault` if the claim is undefined everywhere, for example with a Jacobian that never has full rank, and
    if the error bound of one point exceeds 2**`MOST_LOG2_ERROR`.
    """
    points = Points.of(claim, seed=seed)
    return combined(map(points.at, range(trials)))


def combined(tests: Iterable[ZeroTest]) -> ZeroTest:
    """Combine tests of single points into one, up to the first point with a nonzero element."""
    done = list[ZeroTest]()
    for test in tests:
        done.append(test)
        if not test.zero:
            break
    primes = tuple(prime for test in done for prime in test.primes)
    error = sum(test.log2_error_bound for test in done)
    return replace(done[-1], trials=len(primes), primes=primes, log2_error_bound=error)


def _trial(claim: Claim, rng: random.Random, bits: int) -> tuple[int, Witness | None]:
    for _ in range(ATTEMPTS):
        trial = Trial(random_prime(rng, bits), rng)
        try:
            inputs = inputs_at(claim, trial)
            for found in over_signs(claim, inputs, trial):
                for equality, sums in found:
                    for row, residue in enumerate(sums):
                        if residue:
                            point = tuple((s.label, tuple(v)) for s, v in zip(claim.symbols, inputs, strict=False))
                            return trial.prime, Witness(trial.prime, equality.label, row, 0, residue, point)
            return trial.prime, None
        except ZeroDivision:
            continue
    raise ValueFault(
        f"the exact test: a denominator vanishes at all of {ATTEMPTS} random points; expected one that is not "
        "identically zero"
    )


def empty(claim: Claim, seed: int) -> list[str]:
    """Identically zero quantities: V, D V, or the vector of a term; a proof about them would be empty."""
    rng, claim = random.Random(seed + 3), claim.shared
    for _ in range(ATTEMPTS):
        trial = Trial(random_prime(rng, BITS), rng)
        try:
            inputs = inputs_at(claim, trial)
            point = Point(claim, trial, inputs, Evaluation(claim.tape, inputs, trial, (), claim.places).values)
            named = list(_of_samples(point) if claim.over_samples else _of_a_flow(point))
        except ZeroDivision:
            continue
        return [name for name, values in named if not any(x % trial.prime for x in values)]
    raise ValueFault("the exact test: a denominator vanishes at every random point")


def _of_a_flow(point: Point) -> Iterator[tuple[str, list[int]]]:
    claim, moves = point.claim, point.moves(point.claim.moved)
    V = sum((point.weight(part) * point.storage(part) for part in claim.parts), 0)
    yield "V", [V]
    weighed = [(point.weight(part), each.column) for part in claim.parts for each in differences(point, moves, part)]
    yield claim.D, [sum(weight * sum(column) for weight, column in weighed)]
    for part in claim.parts:
        for term in (*part.stored, *part.dissipation, *part.errors):
            if "vector" in term.parts:
                yield f"{part.block}: {term.name}", point.out(term.parts["vector"])


def _of_samples(point: Point) -> Iterator[tuple[str, list[int]]]:
    claim, moves = point.claim, point.moves(point.claim.moved)
    own = {equality.block: equality for equality in equalities(point, moves) if equality.statement == claim.D}
    for part in claim.parts:
        block = part.block
        if part.stores:
            named = [s for s in own[block].summands if not s.name.endswith(" of V dropped")]
            yield f"{block}: {claim.D}", [sum(sum(s.column) for s in named)]
        for role, terms in (("V", part.stored), ("the decrease of V", part.dissipation)):
            yield from ((f"{block}: term {k} of {role}", [point.value(term)]) for k, term in enumerate(terms, start=1))
        for steps in part.steps:
            rows = [x for k in range(steps.rows) for x in point.out(steps.parts[f"h{k}"])]
            yield f"{block}: regressor rows of {steps.estimate}", rows
        for line in part.lines:
            if line.when is not None:
                yield f"{block}: storage condition of {line.state}", point.out(line.when)
        yield from ((f"{block}: remainder of a plant identity", point.out(relation.rest)) for relation in part.plant)
