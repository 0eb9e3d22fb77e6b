"""The exact test of a claim: the identity, its negative controls, and what is to blame where it fails."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import final

import casadi as ca

from dmframe.certificate import SX
from dmframe.certify.claim import Claim, Field, Part, total
from dmframe.certify.symbols import Group, Symbols
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.model import hashes, symbols_in
from dmframe.exact import Tape, Trial, ZeroDivision, ZeroTest, random_prime, zero_test
from dmframe.port import Side

ATTEMPTS = 20


@final
@dataclass(frozen=True)
class Control:
    """A fault put in on purpose, and whether the test saw it."""

    fault: str
    refuted: bool


@final
@dataclass(frozen=True)
class Refutation:
    """Why an identity does not hold.

    Parameters
    ----------
    blame
        Blocks whose own claim fails; empty where each holds and only their sum does not.
    signals
        The smallest set found: all other signals can be zero, and the residual still is not.
    prime, point, residue
        The exact point: residues modulo the prime of every symbol, and what the residual is there.
    """

    blame: tuple[str, ...]
    signals: tuple[str, ...]
    prime: int
    point: tuple[tuple[str, tuple[int, ...]], ...]
    residue: int


def check_identity(claim: Claim, symbols: Symbols, *, trials: int, seed: int) -> ZeroTest:
    """Is the residual identically zero, and every block's sigma composed as it says?"""
    composed = [
        total_sigma(part) - claim.sigma for part in claim.parts if part.certificate.sigma and claim.cascaded
    ]
    expressions = [claim.residual, *composed]
    return zero_test(symbols.function("residual", expressions), values=symbols.fixed, trials=trials, seed=seed)


def total_sigma(part: Part) -> SX:
    """Sigma as the paying block composes it of what it dissipates."""
    vectors = [term.pieces[0] for term in part.certificate.dissipation]
    return sum((share * vector for share, vector in zip(part.certificate.sigma, vectors, strict=True)), ca.SX(0))


def is_trivial(claim: Claim, symbols: Symbols, seed: int) -> bool:
    """A zero residual of V = 0 or dV/dt = 0 would prove nothing."""
    tests = (
        zero_test(symbols.function("V", [claim.V]), values=symbols.fixed, seed=seed, trials=1),
        zero_test(symbols.function("dV", [claim.rate]), values=symbols.fixed, seed=seed, trials=1),
    )
    return any(test.zero for test in tests)


def negative_controls(claim: Claim, symbols: Symbols, *, seed: int) -> tuple[Control, ...]:
    """Faults that must be refuted: each rate's sign flipped, each term dropped, each gain changed in one place.

    A term that is identically zero (friction that the plant has not) and a gain that V does not hold are no faults to
    put in, and are left out.
    """
    faults = list(_faults(claim))
    gains = _gains(claim, symbols)
    copies = [ca.SX.sym(f"{gain.label}.changed", gain.symbol.shape) for gain in gains]
    residual = _residual_with(claim, [gain.symbol for gain in gains], copies)
    inputs = [stack([group.symbol]) for group in symbols.groups] + [ca.vec(copy) for copy in copies]
    function = ca.Function("controls", inputs, [residual, *(excess for _, excess in faults)])
    tape = Tape.from_function(function)
    rng = random.Random(seed + 1)
    (left,), *outputs = _evaluate(tape, symbols, gains, None, rng)
    found = [Control(name, left + excess != 0) for (name, _), (excess,) in zip(faults, outputs, strict=True) if excess]
    for gain in gains:
        (left,), *_ = _evaluate(tape, symbols, gains, gain.label, rng)
        found.append(Control(f"{gain.label} changed in the equations only", left != 0))
    return tuple(found)


def _gains(claim: Claim, symbols: Symbols) -> list[Group]:
    """The controller's parameters that V or its dissipation holds."""
    blocks = claim.diagram.blocks
    held = symbols_in([claim.V, *(part.dissipation for part in claim.parts)])
    controllers = {name for name, block in blocks.items() if block.side is Side.CONTROLLER}
    return [
        group
        for group in symbols.groups
        if group.label.split(".")[0] in controllers and held & hashes(group.symbol) and group.kind == "parameter"
    ]


def _faults(claim: Claim) -> Iterator[tuple[str, SX]]:
    """Each fault with what it adds to the residual."""
    V, loop = claim.V, claim.loop
    for variable in loop.controller:
        slope = ca.gradient(V, variable.symbol)
        (rate,) = loop.joined([variable.rate])
        gained = ca.dot(slope, ca.densify(rate))
        if not gained.is_zero():
            yield f"sign of d {variable.label}/dt flipped", -2 * gained
    for part in claim.parts:
        for term in part.certificate.dissipation:
            yield f"{part.block}: dissipation of {term.of} dropped", -claim.weight(part) * term.value
        for square in part.certificate.storage:
            rate = Field(claim.diagram).derivative(square.value / 2)
            if not rate.is_zero():
                yield f"{part.block}: storage of {square.of} dropped", -claim.weight(part) * rate


def _residual_with(claim: Claim, gains: Sequence[SX], copies: Sequence[SX]) -> SX:
    """The residual where the equations of motion have other gains than V and the dissipation."""
    field = Field(claim.diagram)
    if gains:
        field = field.with_parameters(stack(gains), stack(copies))
    own = [
        claim.weight(part) * (field.derivative(part.storage) + part.dissipation - part.lemma) for part in claim.parts
    ]
    return total(own) - claim.consumption


def _evaluate(
    tape: Tape, symbols: Symbols, gains: Sequence[Group], changed: str | None, rng: random.Random
) -> list[list[int]]:
    """All faults at one random point; the copy of the gain named `changed` differs from the gain itself."""
    labels = [group.label for group in symbols.groups]
    for _ in range(ATTEMPTS):
        trial = Trial(random_prime(rng), rng)
        try:
            point = [_residues(trial, group.symbol.numel(), group.values) for group in symbols.groups]
            copies = []
            for gain in gains:
                own = point[labels.index(gain.label)]
                copies.append([trial.random() for _ in own] if gain.label == changed else own)
            return tape.evaluate([*point, *copies], trial)
        except ZeroDivision:
            continue
    raise ZeroDivision("a denominator vanishes at every random point")


def _residues(trial: Trial, size: int, values: Sequence[Fraction] | None) -> list[int]:
    return [trial.random() for _ in range(size)] if values is None else [trial.residue(value) for value in values]


def refute(claim: Claim, symbols: Symbols, *, seed: int) -> Refutation:
    """Locate a failure: the blocks to blame, and the fewest signals with which the residual is not zero."""
    blame = tuple(
        part.block
        for part in claim.parts
        if not zero_test(symbols.function("own", [part.residual]), values=symbols.fixed, trials=1, seed=seed).zero
    )
    tape = Tape.from_function(symbols.function("residual", [claim.residual]))
    rng = random.Random(seed + 2)
    zeroed = set[str]()
    for group in symbols.groups:
        if group.kind in ("state", "trajectory", "projection") and _nonzero(tape, symbols, {*zeroed, group.label}, rng):
            zeroed.add(group.label)
    prime, point, residue = _nonzero(tape, symbols, zeroed, rng) or (0, [], 0)
    signals = [g for g in symbols.groups if g.kind in ("state", "trajectory", "projection") and g.label not in zeroed]
    named = tuple((group.label, tuple(values)) for group, values in zip(symbols.groups, point, strict=False))
    return Refutation(blame, tuple(group.label for group in signals), prime, named, residue)


def _nonzero(
    tape: Tape, symbols: Symbols, zeroed: set[str], rng: random.Random
) -> tuple[int, list[list[int]], int] | None:
    """A point with these signals at zero at which the residual is not; None where there is none to be found."""
    for _ in range(ATTEMPTS):
        trial = Trial(random_prime(rng), rng)
        try:
            point = [
                [0] * group.symbol.numel()
                if group.label in zeroed
                else _residues(trial, group.symbol.numel(), group.values)
                for group in symbols.groups
            ]
            residue = tape.evaluate(point, trial)[0][0]
        except ZeroDivision:
            continue
        return (trial.prime, point, residue) if residue else None
    return None
