"""Values of expressions at one random point of a random prime field."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import TypeVar

from dmframe.certify.symbols import Group, Symbols
from dmframe.common.errors import ValueFault
from dmframe.exact import Tape, Trial, ZeroDivision, random_prime
from dmframe.prove.identity import ATTEMPTS, BITS

T = TypeVar("T")


def residues(trial: Trial, group: Group) -> list[int]:
    """A group's residues: its exact values, or random ones."""
    if group.values is None:
        return [trial.random() for _ in range(group.symbol.numel())]
    return [trial.residue(value) for value in group.values]


def at_random_point(tape: Tape, symbols: Symbols, seed: int) -> list[list[int]]:
    """Outputs of a function of all symbols; raises `ValueFault` if it is undefined everywhere."""

    def outputs(trial: Trial) -> list[list[int]]:
        return tape.evaluate([residues(trial, group) for group in symbols.groups], trial)

    return in_random_field(tape.name, seed, outputs)


def in_random_field(name: str, seed: int, found: Callable[[Trial], T]) -> T:
    """Result in the first random field in which no denominator vanishes; raises `ValueFault` after several fields."""
    rng = random.Random(seed + 3)
    for _ in range(ATTEMPTS):
        try:
            return found(Trial(random_prime(rng, BITS), rng))
        except ZeroDivision:
            continue
    raise ValueFault(f"exact test of {name}: a denominator vanishes at every random point")
