"""The exact test of a claim: dV/dt of the diagram, each block's own claim, and how sigma is composed."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import final

import casadi as ca

from dmframe.certificate import SX, Gathered, LogDet, NormSquare, Potential, Square
from dmframe.certify.claim import Claim, Part
from dmframe.certify.operators import Sample
from dmframe.certify.symbols import Group, Symbols
from dmframe.diagram.closed_loop import stack
from dmframe.exact import Tape, Trial, ZeroDivision, ZeroTest, random_prime, zero_test

DEEP = 100
"""How deep two elements are compared before their difference is tested."""

ATTEMPTS = 20
"""Random points tried until no denominator vanishes."""

BITS = 149
"""Of the random primes: five digits of Python's integers hold them, as they hold 127 bits, at the same speed."""


@final
@dataclass(frozen=True)
class Equality:
    """An expression that must vanish identically, and the block that claims it; none for the diagram's D V.

    `scale` is the sum of the absolute values of its terms.
    """

    block: str
    says: str
    expression: SX
    scale: SX


def equalities(claim: Claim) -> list[Equality]:
    """All that a claim states to be zero; the diagram's own, where several blocks store something, comes first.

    The blocks' own claims are not needed for D V of the diagram, where the supplies cancel; but a block whose supply is
    wrong could not be built upon.
    """
    own = claim.operator.name
    found = [] if claim.over_samples else [Equality("", own, claim.residual, _scale(claim))]
    for part in claim.parts:
        if claim.over_samples:
            found += [Equality(part.block, own, part.residual, _own_scale(part))] * bool(part.stored)
            found += of_a_sample(claim.sample, part)
        else:
            found.append(Equality(part.block, "dS/dt", part.residual, _own_scale(part)))
    found += [] if claim.over_samples else [*_memories(claim), *_symmetric(claim)]
    for consumer, block in claim.cross_terms:
        if block is not None and consumer.certificate.consumes is not None:
            wanted, composed = consumer.certificate.consumes.vector, block.composed
            says = f"the vector that it dominates is that of {consumer.block}"
            found.append(Equality(block.block, says, composed - wanted, ca.fabs(composed) + ca.fabs(wanted)))
    return found


def of_a_sample(sample: Sample, part: Part) -> Iterator[Equality]:
    """The moves of estimates and delay lines, the plant's identities, and what the block's output solves."""
    stated, block = part.certificate, part.block
    for name, said in (move for item in stated.steps for move in item.moves.items()):
        yield _equal(block, f"what {name} becomes", sample.next[f"{block}.{name}"], said)
    for line in stated.delay_lines:
        label = f"{block}.{line.state}"
        yield _equal(block, f"what {line.state} keeps", sample.next[label], line.pushed(sample.symbols[label]))
    for identity in stated.plant:
        yield _equal(block, "what the plant's motion obeys", sample.along_the_plant(identity.momentum), -identity.rest)
    for left in stated.solved:
        yield Equality(block, "the equation that its output solves", left, 1 + ca.fabs(left))


def _equal(block: str, says: str, one: SX, other: SX) -> Equality:
    return Equality(block, says, ca.vec(ca.densify(one - other)), ca.vec(ca.fabs(one) + ca.fabs(other)))


def _memories(claim: Claim) -> Iterator[Equality]:
    """Information matrices move as their terms state; once for terms that share one."""
    for part in claim.parts:
        terms = (*part.certificate.storage, *part.certificate.dissipation)
        seen = list[Gathered]()
        for term in (term for term in terms if isinstance(term, Gathered)):
            if any(_same_memory(term, other) for other in seen):
                continue
            seen.append(term)
            moves, said = (
                claim.flow.D(ca.vec(term.memory), f"{part.block}: G of |{term.of}|_G^2"),
                ca.vec(term.rate),
            )
            yield Equality(part.block, f"dG/dt of {term.of}", moves - said, ca.fabs(moves) + ca.fabs(said))


def _symmetric(claim: Claim) -> Iterator[Equality]:
    """Both matrices of a divergence are symmetric: it reads their lower triangles."""
    for part in claim.parts:
        for term in part.certificate.storage:
            if isinstance(term, LogDet):
                for what, matrix in (("", term.matrix), ("the true value of ", term.true)):
                    matrix = ca.densify(ca.SX(matrix))
                    if not ca.is_equal(matrix, matrix.T, DEEP):
                        apart, size = ca.vec(matrix - matrix.T), ca.vec(ca.fabs(matrix) + ca.fabs(matrix.T))
                        yield Equality(part.block, f"{what}{term.of} is symmetric", apart, size)


def _same_memory(one: Gathered, other: Gathered) -> bool:
    pairs = zip(one.pieces[2:], other.pieces[2:], strict=True)
    return all(a.shape == b.shape and ca.is_equal(a, b, 2) for a, b in pairs)


def _scale(claim: Claim) -> SX:
    own = sum((ca.fabs(claim.weight(part)) * _own_scale(part) for part in claim.parts), ca.SX(0))
    return own + ca.fabs(claim.consumption)


def _own_scale(part: Part) -> SX:
    terms = (part.rate, part.certificate.supply, part.dissipation, part.consumption, part.excess, part.lemma)
    return sum((ca.fabs(ca.SX(term)) for term in terms), ca.SX(0))


def check_identity(claim: Claim, symbols: Symbols, *, trials: int, seed: int) -> ZeroTest:
    """The test whether everything vanishes that the claim says to be zero.

    Raises `ValueFault` where it is nowhere defined, such as with a Jacobian that never has full rank.
    """
    function = symbols.function("residual", [equality.expression for equality in equalities(claim)])
    return zero_test(function, values=symbols.fixed, trials=trials, seed=seed, bits=BITS)


def empty_terms(claim: Claim, symbols: Symbols, seed: int) -> list[str]:
    """What is identically zero: V, D V, or the vector of a square, so that nothing would be proved of it."""
    named = list(_of_samples(claim) if claim.over_samples else _of_a_flow(claim))
    tape = Tape.from_function(symbols.function("terms", [expression for _, expression in named]))
    outputs = at_random_point(tape, symbols, seed)
    return [name for (name, _), values in zip(named, outputs, strict=True) if not any(values)]


def _of_a_flow(claim: Claim) -> Iterator[tuple[str, SX]]:
    yield from (("V", claim.V), (claim.operator.name, claim.rate))
    for part in claim.parts:
        for term in (*part.certificate.storage, *part.certificate.dissipation, *part.certificate.errors):
            if isinstance(term, Square | NormSquare | Gathered | Potential):
                yield f"{part.block}: {term.of}", term.vector


def _of_samples(claim: Claim) -> Iterator[tuple[str, SX]]:
    for part in claim.parts:
        stated, block = part.certificate, part.block
        if part.stored:
            yield f"{block}: {claim.operator.name}", part.rate
        for role, terms in (("V", stated.storage), ("what V loses", stated.dissipation)):
            yield from ((f"{block}: term {place} of {role}", ca.SX(t.value)) for place, t in enumerate(terms, start=1))
        yield from ((f"{block}: the rows of {s.estimate}", stack(h for h, _ in s.rows)) for s in stated.steps)
        yield from ((f"{block}: when {item.state} is stored", ca.SX(item.when)) for item in stated.delay_lines)
        yield from ((f"{block}: the rest of a relation", ca.SX(item.rest)) for item in stated.plant)


def at_random_point(tape: Tape, symbols: Symbols, seed: int) -> list[list[int]]:
    """The outputs at one random point of a random prime field."""
    rng = random.Random(seed)
    for _ in range(ATTEMPTS):
        trial = Trial(random_prime(rng), rng)
        try:
            return tape.evaluate([residues(trial, group) for group in symbols.groups], trial)
        except ZeroDivision:
            continue
    raise ZeroDivision("a denominator vanishes at every random point")


def residues(trial: Trial, group: Group, known: Mapping[str, Sequence[Fraction]] | None = None) -> list[int]:
    """A group's random residues, or its own where it is not free or `known`."""
    values = (known or {}).get(group.label, group.values)
    if values is None:
        return [trial.random() for _ in range(group.symbol.numel())]
    return [trial.residue(value) for value in values]
