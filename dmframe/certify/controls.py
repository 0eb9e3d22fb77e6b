"""Fault injection: faults seeded into a claim, each of which the exact test must refute."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import final

import casadi as ca

from dmframe.block.model import symbols_in
from dmframe.certificate import SX, PlantIdentity
from dmframe.certify.claim import Claim, total
from dmframe.certify.identity import ATTEMPTS, BITS, of_a_sample, residues
from dmframe.certify.operators import Flow, Operator, Sample
from dmframe.certify.symbols import Group, Symbols
from dmframe.diagram.closed_loop import stack
from dmframe.exact import Evaluation, Tape, Trial, ZeroDivision, random_prime
from dmframe.port import Side


@final
@dataclass(frozen=True)
class Control:
    """A seeded fault, and whether the test refuted it."""

    fault: str
    refuted: bool


@final
@dataclass(frozen=True)
class _Fault:
    """A factor of a move or of a term, 1 in the claim; where `matters` is identically zero, it is no fault."""

    name: str
    factor: SX
    value: int
    matters: SX


def inject_faults(claim: Claim, symbols: Symbols, *, seed: int) -> tuple[Control, ...]:
    """Seed faults that the identity must refute: each state's move reversed, each term dropped, each gain changed in
    the equations only.

    The faults are put into the operator, into V and into the dissipation, and D V is formed and evaluated anew. A term
    that is identically zero (friction that the plant does not have) and a gain that V does not hold are no faults; nor
    is a gain whose change leaves the moves of all that V holds as they are, identically, such as that of a regressor
    that is zero for this robot. This is read from the moves, never from the residual: a change of the moves that the
    residual does not show is a fault that was missed.
    """
    gains = _gains(claim, symbols)
    copies = [ca.SX.sym(f"{gain.label}.changed", gain.symbol.shape) for gain in gains]
    changed: Operator = claim.operator.with_parameters(stack(gain.symbol for gain in gains), stack(copies))
    flips = dict(_flips(claim))
    moves = _moves(claim, changed)
    changed = changed.with_factors({label: fault.factor for label, fault in flips.items()})
    faults, residual = list(flips.values()), list[SX]()
    for own, left in _sampled(claim, changed) if claim.over_samples else _dropped(claim, changed):
        faults += own
        residual += left
    # evaluated once a fault, so that common subexpressions are worth finding
    whole, moves = ca.cse([stack(residual), moves]) if not claim.over_samples else (stack(residual), moves)
    factors = [fault.factor for fault in faults]
    tape = Tape.from_function(symbols.function("controls", [whole, moves], [*copies, *factors]))
    terms = Tape.from_function(symbols.function("terms", [fault.matters for fault in faults]))
    point = _Point(tape, symbols, gains, len(faults), random.Random(seed + 1))
    found = [
        Control(fault.name, point.refutes(k, fault.value))
        for k, (fault, (weight,)) in enumerate(zip(faults, point.values(terms), strict=True))
        if weight
    ]
    for gain in gains:
        otherwise, refuted = point.with_gain(gain.label)
        if otherwise:
            found.append(Control(f"{gain.label} changed in the equations only", refuted))
    return tuple(found)


def _gains(claim: Claim, symbols: Symbols) -> list[Group]:
    """The controller's parameters that V, its dissipation, or the steps of an estimate hold."""
    blocks = claim.diagram.blocks
    steps = [item for part in claim.parts for item in part.certificate.steps]
    held = symbols_in([claim.V, *(item for part in claim.parts for item in (part.dissipation, part.excess))])
    held |= symbols_in(ca.SX(piece) for item in steps for piece in (*item.constant.values(), *item.box))
    controllers = {name for name, block in blocks.items() if block.side is Side.CONTROLLER}
    return [
        group
        for group in symbols.groups
        if group.label.split(".")[0] in controllers and held & symbols_in([group.symbol]) and group.kind == "parameter"
    ]


def _moves(claim: Claim, operator: Operator) -> SX:
    """D of all that V holds; over samples, the next values of all sampled states."""
    if claim.over_samples:
        return operator.moves(list(claim.sample.symbols))
    return operator.D(stack(ca.symvar(claim.V)), "all that V holds")


def _flips(claim: Claim) -> Iterator[tuple[str, _Fault]]:
    """A reversed move for each of the controller's states that V, or a delay line, holds."""
    lines = {f"{part.block}.{item.state}" for part in claim.parts for item in part.certificate.delay_lines}
    V, operator = claim.V, claim.operator
    for variable in claim.loop.stepped if claim.over_samples else claim.loop.controller:
        label = variable.label
        if claim.over_samples:
            held = label in lines or symbols_in([V]) & symbols_in([variable.symbol])
            matters = ca.sum1(ca.vec(operator.moves([label]) - ca.vec(variable.symbol))) if held else ca.SX(0)
        else:
            matters = ca.dot(ca.vec(ca.gradient(V, variable.symbol)), operator.moves([label]))
        if not matters.is_zero():
            name = operator.flip.format(label)
            yield label, _Fault(name, ca.SX.sym(name), -1, matters)


def _dropped(claim: Claim, operator: Operator) -> Iterator[tuple[list[_Fault], list[SX]]]:
    """In continuous time: each term dropped, and the residual of D V."""
    own, faults = list[SX](), list[_Fault]()
    honest = Flow(claim.diagram)
    for part in claim.parts:
        rate = dissipation = excess = ca.SX(0)
        for square in part.certificate.storage:
            term = operator.D(square.value / 2, square.of)
            if not term.is_zero():
                matters = honest.D(square.value / 2, square.of)
                faults.append(_without(f"{part.block}: storage of {square.of} dropped", matters))
                rate += faults[-1].factor * term
        for spent in part.certificate.dissipation:
            faults.append(_without(f"{part.block}: dissipation of {spent.of} dropped", spent.value))
            dissipation += faults[-1].factor * spent.value
        for left in part.certificate.excess:
            faults.append(_without(f"{part.block}: bounded residual of {left.of} dropped", left.value))
            excess += faults[-1].factor * left.value
        own.append(claim.weight(part) * (rate + dissipation - excess - part.lemma))
    yield faults, [total(own) - claim.consumption]


def _sampled(claim: Claim, operator: Operator) -> Iterator[tuple[list[_Fault], list[SX]]]:
    """Over samples: each part's losses, gains and rests dropped, and all its equalities."""
    assert isinstance(operator, Sample)
    for part in claim.parts:
        loses = _without(f"{part.block}: what V loses dropped", part.dissipation)
        gains = _without(f"{part.block}: what V gains dropped", part.excess)
        stated = part.certificate
        rests = [
            _without(f"{part.block}: the rest of {which} dropped", ca.sum1(ca.SX(item.rest)))
            for which, item in zip(_numbered("its relation", len(stated.plant)), stated.plant, strict=True)
        ]
        plant = tuple(
            PlantIdentity(item.momentum, fault.factor * item.rest)
            for item, fault in zip(stated.plant, rests, strict=True)
        )
        left = list[SX]()
        if part.stored:
            change = total([item.change for item in stated.steps]) / 2
            change += operator.D(total([term.value for term in stated.storage]) / 2, "V")
            left.append(change + loses.factor * part.dissipation - gains.factor * part.excess)
        faulty = replace(part, certificate=replace(stated, plant=plant))
        yield [loses, gains, *rests], [*left, *(item.expression for item in of_a_sample(operator, faulty))]


def _without(name: str, matters: SX) -> _Fault:
    return _Fault(name, ca.SX.sym(name), 0, matters)


def _numbered(what: str, count: int) -> list[str]:
    return [what] if count == 1 else [f"{what} {place}" for place in range(1, count + 1)]


@final
class _Point:
    """One random point of a random prime field, at which one fault after the other is put in."""

    def __init__(self, tape: Tape, symbols: Symbols, gains: Sequence[Group], factors: int, rng: random.Random) -> None:
        self._others = dict[str, list[int]]()
        for _ in range(ATTEMPTS):
            self._trial = Trial(random_prime(rng, BITS), rng)
            try:
                self._own = {group.label: residues(self._trial, group) for group in symbols.groups}
                inputs = [*self._own.values(), *(self._own[gain.label] for gain in gains), *([[1]] * factors)]
                first = len(self._own)
                self._places = {gain.label: place for place, gain in enumerate(gains, start=first)}
                self._factors = first + len(gains)
                self._evaluation = Evaluation(tape, inputs, self._trial, range(first, len(inputs)))
                _, self._moves = self._evaluation.outputs
            except ZeroDivision:
                continue
            return
        raise ZeroDivision("a denominator vanishes at every random point")

    def refutes(self, fault: int, value: int) -> bool:
        """True where the residual is not zero with this factor at this value."""
        residual, _ = self._evaluation.changed({self._factors + fault: [value % self._trial.prime]})
        return any(residual)

    def with_gain(self, gain: str) -> tuple[bool, bool]:
        """Whether a rate of what V holds differs with this gain changed, and whether the residual is not zero then."""
        residual, moves = self._evaluation.changed({self._places[gain]: self._changed(gain)})
        return moves != self._moves, any(residual)

    def _changed(self, label: str) -> list[int]:
        if label not in self._others:
            self._others[label] = [self._trial.random() for _ in self._own[label]]
        return self._others[label]

    def values(self, tape: Tape) -> list[list[int]]:
        """The outputs of another tape at the same point."""
        return tape.evaluate(list(self._own.values()), self._trial)
