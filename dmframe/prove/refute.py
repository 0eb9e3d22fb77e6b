"""Why an identity does not hold: the blocks to blame, the fewest signals, and an exact point that replays."""

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
"""Kinds of symbols that can be zero without changing what the graph is."""

_Found = tuple[int, tuple[tuple[str, tuple[int, ...]], ...], int]


@final
@dataclass(frozen=True)
class Refutation:
    """Why an identity does not hold.

    Parameters
    ----------
    blame
        Blocks whose own claim fails; empty where each holds and only their sum does not.
    signals
        With all other signals at zero, the residual still is not; with any one of these at zero as well, it is.
    prime, point, residue
        The exact point: residues modulo the prime of every symbol and of every function of them that the field does
        not have, ``"cos, sin of 123": (4, 5)``; and what the residual is there.
    says
        What is not so: ``dV/dt`` of the diagram, or ``block: dS/dt``, ``block: sigma``, ``block: V(next) - V``.
    """

    blame: tuple[str, ...]
    signals: tuple[str, ...]
    prime: int
    point: tuple[tuple[str, tuple[int, ...]], ...]
    residue: int
    says: str = "dV/dt"


def refute(claim: Claim, *, seed: int) -> Refutation:
    """Locate a failure among what a claim says to be zero."""
    claim = claim.shared
    found_false = failing(claim, seed=seed)
    blame = dict.fromkeys(block for _, block in found_false if block)
    says, rng = found_false[0][0], random.Random(seed + 2)
    zeroed = _zeroed(claim, says, rng)
    found = _nonzero(claim, says, zeroed, rng) or _nonzero(claim, says, set(), rng)
    prime, point, residue = found or (0, (), 0)
    signals = tuple(s.label for s in claim.symbols if s.kind in SIGNALS and s.label not in zeroed)
    return Refutation(tuple(blame), signals, prime, point, residue, says)


def replay(claim: Claim, refutation: Refutation) -> int:
    """What the residual is at a refutation's point, from the point alone."""
    given = dict(refutation.point)
    functions = {label: values for label, values in given.items() if " of " in label}
    trial = Trial(refutation.prime, random.Random(0), functions)
    inputs = [list(given[symbol.label]) for symbol in claim.symbols]
    inputs += [list(given[label]) for label in claim.gains]
    return _first(claim, refutation.says, inputs, trial)


def failing(claim: Claim, *, seed: int) -> list[tuple[str, str]]:
    """The labels and blocks of what does not vanish at one random point, for some choice of signs."""
    rng = random.Random(seed)
    for _ in range(ATTEMPTS):
        trial = Trial(random_prime(rng), rng)
        try:
            found = dict[tuple[str, str], bool]()
            for choice in over_signs(claim, inputs_at(claim, trial), trial):
                for equality, left in choice:
                    key = equality.label, equality.block
                    found[key] = found.get(key, False) or any(left)
        except ZeroDivision:
            continue
        if any(found.values()):
            return [key for key, fails in found.items() if fails]
    raise ZeroDivision("the claim vanishes, or a denominator does, at every random point")


def _zeroed(claim: Claim, says: str, rng: random.Random) -> set[str]:
    """Signals that can be zero together; gone through until no further one can."""
    signals = [symbol.label for symbol in claim.symbols if symbol.kind in SIGNALS]
    zeroed = set[str]()
    while True:
        before = len(zeroed)
        for label in signals:
            if label not in zeroed and _nonzero(claim, says, {*zeroed, label}, rng):
                zeroed.add(label)
        if len(zeroed) == before:
            return zeroed


def _nonzero(claim: Claim, says: str, zeroed: Collection[str], rng: random.Random) -> _Found | None:
    """A point with these signals at zero at which the residual is not; None where there is none to be found."""
    zeros = {symbol.label: (Fraction(0),) * symbol.size for symbol in claim.symbols if symbol.label in zeroed}
    for _ in range(ATTEMPTS):
        trial = Trial(random_prime(rng), rng)
        try:
            inputs = inputs_at(claim, trial, zeros)
            residue = _first(claim, says, inputs, trial)
        except ZeroDivision:
            continue
        named = [(s.label, tuple(values)) for s, values in zip(claim.symbols, inputs, strict=False)]
        return (trial.prime, (*named, *trial.functions.items()), residue) if residue else None
    return None


def _first(claim: Claim, says: str, inputs: Sequence[Sequence[int]], trial: Trial) -> int:
    """The first residue that is not zero, over all choices of signs."""
    for choice in over_signs(claim, inputs, trial, says):
        for _, left in choice:
            if any(left):
                return next(residue for residue in left if residue)
    return 0
