"""Why an identity does not hold: the blocks to blame, the fewest signals, and an exact point that replays."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import final

from dmframe.certify.identity import ATTEMPTS, Equality, residues
from dmframe.certify.symbols import Symbols
from dmframe.exact import Tape, Trial, ZeroDivision, random_prime, sign_choices, zero_test

SIGNALS = ("state", "trajectory", "projection")
"""Kinds of symbols that can be zero without changing what the graph is."""


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


def refute(claimed: Sequence[Equality], symbols: Symbols, *, seed: int) -> Refutation:
    """Locate a failure among what is claimed to vanish."""
    failing = [equality for equality in claimed if not _vanishes(equality, symbols, seed)]
    blame = dict.fromkeys(equality.block for equality in failing if equality.block)
    first = failing[0]
    tape = Tape.from_function(symbols.function("residual", [first.expression]))
    rng = random.Random(seed + 2)
    zeroed = _zeroed(tape, symbols, rng)
    found = _nonzero(tape, symbols, zeroed, rng) or _nonzero(tape, symbols, set(), rng)
    prime, point, residue = found or (0, (), 0)
    signals = tuple(g.label for g in symbols.groups if g.kind in SIGNALS and g.label not in zeroed)
    says = f"{first.block}: {first.says}" if first.block else first.says
    return Refutation(tuple(blame), signals, prime, point, residue, says)


def replay(claimed: Sequence[Equality], symbols: Symbols, refutation: Refutation) -> int:
    """What the residual is at a refutation's point, from the point alone."""
    (equality,) = (e for e in claimed if (f"{e.block}: {e.says}" if e.block else e.says) == refutation.says)
    given = dict(refutation.point)
    functions = {label: values for label, values in given.items() if " of " in label}
    trial = Trial(refutation.prime, random.Random(0), functions)
    tape = Tape.from_function(symbols.function("residual", [equality.expression]))
    return _first(tape, [given[group.label] for group in symbols.groups], trial)


def _vanishes(equality: Equality, symbols: Symbols, seed: int) -> bool:
    function = symbols.function("own", [equality.expression])
    return zero_test(function, values=symbols.fixed, trials=1, seed=seed).zero


def _zeroed(tape: Tape, symbols: Symbols, rng: random.Random) -> set[str]:
    """Signals that can be zero together; gone through until no further one can."""
    signals = [group.label for group in symbols.groups if group.kind in SIGNALS]
    zeroed = set[str]()
    while True:
        before = len(zeroed)
        for label in signals:
            if label not in zeroed and _nonzero(tape, symbols, {*zeroed, label}, rng):
                zeroed.add(label)
        if len(zeroed) == before:
            return zeroed


def _nonzero(
    tape: Tape, symbols: Symbols, zeroed: set[str], rng: random.Random
) -> tuple[int, tuple[tuple[str, tuple[int, ...]], ...], int] | None:
    """A point with these signals at zero at which the residual is not; None where there is none to be found."""
    zeros = {g.label: (Fraction(0),) * g.symbol.numel() for g in symbols.groups if g.label in zeroed}
    for _ in range(ATTEMPTS):
        trial = Trial(random_prime(rng), rng)
        try:
            point = [residues(trial, group, zeros) for group in symbols.groups]
            residue = _first(tape, point, trial)
        except ZeroDivision:
            continue
        named = [(group.label, tuple(values)) for group, values in zip(symbols.groups, point, strict=True)]
        return (trial.prime, (*named, *trial.functions.items()), residue) if residue else None
    return None


def _first(tape: Tape, point: Sequence[Sequence[int]], trial: Trial) -> int:
    """The first residue that is not zero, over all choices of signs."""
    for residues_there, *_ in sign_choices(tape, point, trial):
        for residue in residues_there:
            if residue:
                return residue
    return 0
