"""Reason why an identity does not hold: the failing blocks, a minimal set of signals, and an exact counterexample."""

from __future__ import annotations

import random
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Final, final

from dmframe.exact import Trial, ZeroDivision, random_prime
from dmframe.prove.claim import Claim
from dmframe.prove.identity import ATTEMPTS, inputs_at, over_signs

SIGNALS: Final = ("state", "trajectory", "stepping", "projection")
"""Kinds of symbols that can be set to zero without changing the graph."""

_Found = tuple[int, tuple[tuple[str, tuple[int, ...]], ...], int]


@final
@dataclass(frozen=True)
class Refutation:
    """Reason why an identity does not hold.

    Parameters
    ----------
    blame
        Blocks whose own equality fails; empty if each holds and only their sum fails.
    signals
        Minimal set: the residual is nonzero with all other signals at zero, and zero if any one of these is zero as
        well. The exact point: residues, modulo the prime, of every symbol and of every function that a field does not
        have,
        ``"cos, sin of 123": (4, 5)``; and the residual there.
    statement
        The failing equality: ``dV/dt`` of the diagram, or ``block: dS/dt``, ``block: sigma``, ``block: V(next) - V``.
    """

    blame: tuple[str, ...]
    signals: tuple[str, ...]
    prime: int
    point: tuple[tuple[str, tuple[int, ...]], ...]
    residue: int
    statement: str = "dV/dt"


def refute(claim: Claim, *, seed: int) -> Refutation:
    """Locate the failing equality of a claim."""
    claim = claim.shared
    failures = failing(claim, seed=seed)
    blame = dict.fromkeys(block for _, block in failures if block)
    statement, rng = failures[0][0], random.Random(seed + 2)
    zeroed = _zeroed(claim, statement, rng)
    found = _nonzero(claim, statement, zeroed, rng) or _nonzero(claim, statement, set(), rng)
    prime, point, residue = found or (0, (), 0)
    signals = tuple(s.label for s in claim.symbols if s.kind in SIGNALS and s.label not in zeroed)
    return Refutation(tuple(blame), signals, prime, point, residue, statement)


def replay(claim: Claim, refutation: Refutation) -> int:
    """Residual at the point of a refutation, computed from the point alone."""
    given = dict(refutation.point)
    functions = {label: values for label, values in given.items() if " of " in label}
    trial = Trial(refutation.prime, random.Random(0), functions)
    inputs = [list(given[symbol.label]) for symbol in claim.symbols]
    inputs += [list(given[label]) for label in claim.gains]
    return _first(claim, refutation.statement, inputs, trial)


def failing(claim: Claim, *, seed: int) -> list[tuple[str, str]]:
    """Labels and blocks of the equalities that fail at one random point, for some choice of signs."""
    rng = random.Random(seed)
    for _ in range(ATTEMPTS):
        trial = Trial(random_prime(rng), rng)
        try:
            found = dict[tuple[str, str], bool]()
            for choice in over_signs(claim, inputs_at(claim, trial), trial):
                for equality, sums in choice:
                    key = equality.label, equality.block
                    found[key] = found.get(key, False) or any(sums)
        except ZeroDivision:
            continue
        if any(found.values()):
            return [key for key, fails in found.items() if fails]
    raise ZeroDivision("the claim vanishes, or a denominator does, at every random point")


def _zeroed(claim: Claim, statement: str, rng: random.Random) -> set[str]:
    """Signals that can be zero together; repeated until no further one can be."""
    signals = [symbol.label for symbol in claim.symbols if symbol.kind in SIGNALS]
    zeroed = set[str]()
    while True:
        before = len(zeroed)
        for label in signals:
            if label not in zeroed and _nonzero(claim, statement, {*zeroed, label}, rng):
                zeroed.add(label)
        if len(zeroed) == before:
            return zeroed


def _nonzero(claim: Claim, statement: str, zeroed: Collection[str], rng: random.Random) -> _Found | None:
    """A point with these signals at zero and a nonzero residual; None if none is found."""
    zeros = {symbol.label: (Fraction(0),) * symbol.size for symbol in claim.symbols if symbol.label in zeroed}
    for _ in range(ATTEMPTS):
        trial = Trial(random_prime(rng), rng)
        try:
            inputs = inputs_at(claim, trial, zeros)
            residue = _first(claim, statement, inputs, trial)
        except ZeroDivision:
            continue
        named = [(s.label, tuple(values)) for s, values in zip(claim.symbols, inputs, strict=False)]
        return (trial.prime, (*named, *trial.functions.items()), residue) if residue else None
    return None


def _first(claim: Claim, statement: str, inputs: Sequence[Sequence[int]], trial: Trial) -> int:
    """The first nonzero residue, over all choices of signs."""
    for choice in over_signs(claim, inputs, trial, statement):
        for _, sums in choice:
            if any(sums):
                return next(residue for residue in sums if residue)
    return 0
