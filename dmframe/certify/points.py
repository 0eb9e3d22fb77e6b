"""Values of expressions at one random point of a random prime field."""

from __future__ import annotations

import random

from dmframe.certify.symbols import Group, Symbols
from dmframe.errors import ValueFault
from dmframe.exact import Tape, Trial, ZeroDivision, random_prime
from dmframe.prove.identity import ATTEMPTS, BITS


def residues(trial: Trial, group: Group) -> list[int]:
    """A group's residues: its exact values, or random ones."""
    if group.values is None:
        return [trial.random() for _ in range(group.symbol.numel())]
    return [trial.residue(value) for value in group.values]


def at_random_point(tape: Tape, symbols: Symbols, seed: int) -> list[list[int]]:
    """The outputs of a function of all symbols; raises `ValueFault` where it is nowhere defined."""
    rng = random.Random(seed + 3)
    for _ in range(ATTEMPTS):
        trial = Trial(random_prime(rng, BITS), rng)
        try:
            return tape.evaluate([residues(trial, group) for group in symbols.groups], trial)
        except ZeroDivision:
            continue
    raise ValueFault(f"exact test of {tape.name}: a denominator vanishes at every random point")
