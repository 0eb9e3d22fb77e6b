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
from dmframe.certify.symbols import Group, Symbols
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
    """An expression that must vanish identically, and the block whose word it is; none for the diagram's dV/dt.

    `scale` is the sum of the absolute values of its terms.
    """

    block: str
    says: str
    expression: SX
    scale: SX


def equalities(claim: Claim) -> list[Equality]:
    """All that a claim says to be zero; the diagram's own comes first.

    The blocks' own claims are not needed for dV/dt of the diagram, where the supplies cancel; but a block whose supply
    is not what it says could not be built upon.
    """
    found = [Equality("", "dV/dt", claim.residual, _scale(claim))]
    found += [Equality(part.block, "dS/dt", part.residual, _own_scale(part)) for part in claim.parts]
    found += [*_memories(claim), *_symmetric(claim)]
    for consumer, payer in claim.payments:
        if payer is not None and consumer.certificate.consumes is not None:
            wanted, paid = consumer.certificate.consumes.vector, payer.composed
            says = f"what it pays for is what {consumer.block} consumes"
            found.append(Equality(payer.block, says, paid - wanted, ca.fabs(paid) + ca.fabs(wanted)))
    return found


def _memories(claim: Claim) -> Iterator[Equality]:
    """What is gathered moves as its term says; of terms that share it, told once."""
    for part in claim.parts:
        terms = (*part.certificate.storage, *part.certificate.dissipation)
        seen = list[Gathered]()
        for term in (term for term in terms if isinstance(term, Gathered)):
            if any(_same_memory(term, other) for other in seen):
                continue
            seen.append(term)
            moves, said = (
                claim.field.derivative(ca.vec(term.memory), f"{part.block}: G of |{term.of}|_G^2"),
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
    """What is identically zero: V, dV/dt, or the vector of a square, of which then nothing would be said."""
    squares = [
        (f"{part.block}: {term.of}", term.vector)
        for part in claim.parts
        for term in (*part.certificate.storage, *part.certificate.dissipation, *part.certificate.errors)
        if isinstance(term, Square | NormSquare | Gathered | Potential)
    ]
    named = [("V", claim.V), ("dV/dt", claim.rate), *squares]
    tape = Tape.from_function(symbols.function("terms", [expression for _, expression in named]))
    outputs = at_random_point(tape, symbols, seed)
    return [name for (name, _), values in zip(named, outputs, strict=True) if not any(values)]


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
