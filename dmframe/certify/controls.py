"""Negative controls: faults put in on purpose, each of which the exact test must see."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import final

import casadi as ca

from dmframe.block.model import symbols_in
from dmframe.certificate import SX
from dmframe.certify.claim import Claim, Field, total
from dmframe.certify.identity import ATTEMPTS, residues
from dmframe.certify.symbols import Group, Symbols
from dmframe.diagram.closed_loop import stack
from dmframe.exact import Tape, Trial, ZeroDivision, random_prime
from dmframe.port import Side


@final
@dataclass(frozen=True)
class Control:
    """A fault put in on purpose, and whether the test saw it."""

    fault: str
    refuted: bool


@final
@dataclass(frozen=True)
class _Fault:
    """A factor of a rate or of a term, 1 in the claim as it stands; `matters`: what must not be zero, or it is none."""

    name: str
    factor: SX
    value: int
    matters: SX


def negative_controls(claim: Claim, symbols: Symbols, *, seed: int) -> tuple[Control, ...]:
    """Faults that must be refuted: each rate's sign flipped, each term dropped, each gain changed in one place.

    The faults stand in the field, in V and in the dissipation, and all of it is differentiated and evaluated anew. A
    term that is identically zero (friction that the plant has not) and a gain that V does not hold are no faults; nor
    is a gain whose change leaves the rates of all that V holds as they are, identically, such as that of a regressor
    that is zero for this robot. This is read from the rates, never from the residual: a change of the rates that the
    residual does not show is a fault that was missed.
    """
    gains = _gains(claim, symbols)
    copies = [ca.SX.sym(f"{gain.label}.changed", gain.symbol.shape) for gain in gains]
    field = Field(claim.diagram)
    if gains:
        field = field.with_parameters(stack(gain.symbol for gain in gains), stack(copies))
    faults, residual = _faulty(claim, field)
    factors = [fault.factor for fault in faults]
    # evaluated once a fault, so that it is worth finding what it holds twice
    residual, moves = ca.cse([residual, field.derivative(stack(ca.symvar(claim.V)), "all that V holds")])
    tape = Tape.from_function(symbols.function("controls", [residual, moves], [*copies, *factors]))
    terms = Tape.from_function(symbols.function("terms", [fault.matters for fault in faults]))
    point = _Point(tape, symbols, gains, len(faults), random.Random(seed + 1))
    found = [
        Control(fault.name, point.refutes(None, k, fault.value))
        for k, (fault, (weight,)) in enumerate(zip(faults, point.values(terms), strict=True))
        if weight
    ]
    found += [
        Control(f"{gain.label} changed in the equations only", point.refutes(gain.label))
        for gain in gains
        if point.moves_otherwise(gain.label)
    ]
    return tuple(found)


def _gains(claim: Claim, symbols: Symbols) -> list[Group]:
    """The controller's parameters that V or its dissipation holds."""
    blocks = claim.diagram.blocks
    held = symbols_in([claim.V, *(part.dissipation for part in claim.parts)])
    controllers = {name for name, block in blocks.items() if block.side is Side.CONTROLLER}
    return [
        group
        for group in symbols.groups
        if group.label.split(".")[0] in controllers and held & symbols_in([group.symbol]) and group.kind == "parameter"
    ]


def _faulty(claim: Claim, field: Field) -> tuple[list[_Fault], SX]:
    """All faults, and the residual as a function of their factors."""
    flips = dict(_flips(claim))
    field = field.with_factors({label: fault.factor for label, fault in flips.items()})
    faults, own, honest = list(flips.values()), list[SX](), Field(claim.diagram)
    for part in claim.parts:
        rate = dissipation = excess = ca.SX(0)
        for square in part.certificate.storage:
            term = field.derivative(square.value / 2, square.of)
            if not term.is_zero():
                matters = honest.derivative(square.value / 2, square.of)
                faults.append(_dropped(f"{part.block}: storage of {square.of} dropped", matters))
                rate += faults[-1].factor * term
        for spent in part.certificate.dissipation:
            faults.append(_dropped(f"{part.block}: dissipation of {spent.of} dropped", spent.value))
            dissipation += faults[-1].factor * spent.value
        for left in part.certificate.excess:
            faults.append(_dropped(f"{part.block}: bounded residual of {left.of} dropped", left.value))
            excess += faults[-1].factor * left.value
        own.append(claim.weight(part) * (rate + dissipation - excess - part.lemma))
    return faults, total(own) - claim.consumption


def _flips(claim: Claim) -> Iterator[tuple[str, _Fault]]:
    V, loop = claim.V, claim.loop
    rates = loop.joined(loop.rates_of(loop.controller))
    for variable, rate in zip(loop.controller, rates, strict=True):
        gained = ca.dot(ca.gradient(V, variable.symbol), ca.densify(rate))
        if not gained.is_zero():
            name = f"sign of d {variable.label}/dt flipped"
            yield variable.label, _Fault(name, ca.SX.sym(name), -1, gained)


def _dropped(name: str, matters: SX) -> _Fault:
    return _Fault(name, ca.SX.sym(name), 0, matters)


@final
class _Point:
    """One random point of a random prime field, at which one fault after the other is put in."""

    def __init__(self, tape: Tape, symbols: Symbols, gains: Sequence[Group], factors: int, rng: random.Random) -> None:
        self._tape, self._gains, self._factors = tape, gains, factors
        self._others = dict[str, list[int]]()
        for _ in range(ATTEMPTS):
            self._trial = Trial(random_prime(rng), rng)
            try:
                self._own = {group.label: residues(self._trial, group) for group in symbols.groups}
                _, self._moves = self._at(None)
            except ZeroDivision:
                continue
            return
        raise ZeroDivision("a denominator vanishes at every random point")

    def refutes(self, gain: str | None, fault: int | None = None, value: int = 1) -> bool:
        """True where the residual is not zero with this gain changed, and this factor at this value."""
        return self._at(gain, fault, value)[0] != [0]

    def moves_otherwise(self, gain: str) -> bool:
        """True where a rate of what V holds differs with this gain changed."""
        return self._at(gain)[1] != self._moves

    def _at(self, gain: str | None, fault: int | None = None, value: int = 1) -> list[list[int]]:
        """The residual, and the rates."""
        copies = [self._changed(g.label) if g.label == gain else self._own[g.label] for g in self._gains]
        factors = [[value % self._trial.prime] if k == fault else [1] for k in range(self._factors)]
        return self._tape.evaluate([*self._own.values(), *copies, *factors], self._trial)

    def _changed(self, label: str) -> list[int]:
        if label not in self._others:
            self._others[label] = [self._trial.random() for _ in self._own[label]]
        return self._others[label]

    def values(self, tape: Tape) -> list[list[int]]:
        """The outputs of another tape at the same point."""
        return tape.evaluate(list(self._own.values()), self._trial)
