"""Negative controls of a proof over samples: faults put in on purpose, each of which the exact test must see."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import final

import casadi as ca

from dmframe.block.model import symbols_in
from dmframe.certificate import SX, Relation
from dmframe.certify.controls import Control
from dmframe.certify.identity import ATTEMPTS, BITS, residues
from dmframe.certify.samples import SampledClaim, SampledPart
from dmframe.certify.symbols import Group, Symbols
from dmframe.diagram.closed_loop import stack
from dmframe.exact import Tape, Trial, ZeroDivision, random_prime
from dmframe.port import Side


@final
@dataclass(frozen=True, eq=False)
class _Fault:
    """A factor, 1 in the claim as it stands; `matters` must not be zero, or it is none."""

    name: str
    factor: SX
    value: int
    matters: SX


def sampled_controls(claim: SampledClaim, symbols: Symbols, *, seed: int) -> tuple[Control, ...]:
    """Faults that must be refuted: the move of each state that V or a memory holds reversed, each sum dropped, each
    relation's rest dropped, each gain changed in what runs and not in what is claimed.
    """
    gains = _gains(claim, symbols)
    copies = [ca.SX.sym(f"{gain.label}.changed", gain.symbol.shape) for gain in gains]
    faults, expressions = _faulty(claim, gains, copies)
    moves = list(_copied(claim, gains, copies).values())
    tape = Tape.from_function(
        symbols.function("controls", [stack(expressions), stack(moves)], [*copies, *(f.factor for f in faults)])
    )
    terms = Tape.from_function(symbols.function("terms", [fault.matters for fault in faults]))
    point = _Point(tape, terms, symbols, gains, faults, random.Random(seed + 1))
    found = [Control(fault.name, point.refutes(fault)) for fault in faults if point.matters(fault)]
    return (
        *found,
        *(
            Control(f"{gain.label} changed in the equations only", point.refutes(gain))
            for gain in gains
            if point.moves_otherwise(gain)
        ),
    )


def _gains(claim: SampledClaim, symbols: Symbols) -> list[Group]:
    """The controller's parameters that the claim holds."""
    blocks = claim.base.diagram.blocks
    held = symbols_in([item for part in claim.parts for item in (part.V, part.lost, part.gained)])
    steps = [item for part in claim.parts for item in part.steps]
    held |= symbols_in(ca.SX(piece) for item in steps for piece in (*item.constant.values(), *item.box))
    return [
        group
        for group in symbols.groups
        if group.kind == "parameter"
        and (block := blocks.get(group.label.split(".")[0])) is not None
        and block.side is Side.CONTROLLER
        and held & symbols_in([group.symbol])
    ]


def _copied(claim: SampledClaim, gains: Sequence[Group], copies: Sequence[SX]) -> Mapping[str, SX]:
    """What the states become with other gains."""
    if not gains:
        return claim.next
    values = ca.substitute(list(claim.next.values()), [stack(g.symbol for g in gains)], [stack(copies)])
    return dict(zip(claim.next, values, strict=True))


def _faulty(claim: SampledClaim, gains: Sequence[Group], copies: Sequence[SX]) -> tuple[list[_Fault], list[SX]]:
    """All faults, and what has to vanish as a function of their factors."""
    flips = dict(_flips(claim))
    becomes = {
        label: value if label not in flips else _turned(claim.symbols[label], value, flips[label].factor)
        for label, value in _copied(claim, gains, copies).items()
    }
    changed = replace(claim, next=becomes)
    faults, expressions = list(flips.values()), list[SX]()
    for part in claim.parts:
        sums = [
            _Fault(f"{part.block}: what V {word} dropped", ca.SX.sym(word), 0, value)
            for word, value in (("loses", part.lost), ("gains", part.gained))
        ]
        rests = [
            _Fault(f"{part.block}: the rest of {which} dropped", ca.SX.sym("rest"), 0, ca.sum1(ca.SX(item.rest)))
            for which, item in zip(_numbered("its relation", len(part.relations)), part.relations, strict=True)
        ]
        (loses, gains_too), faulty = sums, _with_rests(part, [fault.factor for fault in rests])
        if part.stored:
            spent = loses.factor * part.lost - gains_too.factor * part.gained
            expressions.append(changed.change(part) + spent)
        expressions += [item.expression for item in changed.of(faulty) if item.says != "V(next) - V"]
        faults += [*sums, *rests]
    return faults, expressions


def _numbered(what: str, count: int) -> list[str]:
    return [what] if count == 1 else [f"{what} {place}" for place in range(1, count + 1)]


def _turned(symbol: SX, becomes: SX, factor: SX) -> SX:
    return symbol + factor * (becomes - symbol)


def _flips(claim: SampledClaim) -> Iterator[tuple[str, _Fault]]:
    """A reversed move for each state that V or a memory holds."""
    for part in claim.parts:
        used = symbols_in([part.V])
        kept = {f"{part.block}.{item.state}" for item in part.kept}
        for label, symbol in claim.symbols.items():
            if label in kept or used & symbols_in([symbol]):
                moves = ca.sum1(ca.vec(claim.next[label] - symbol))
                yield label, _Fault(f"{label}: its move reversed", ca.SX.sym("move"), -1, moves)


def _with_rests(part: SampledPart, factors: Sequence[SX]) -> SampledPart:
    pairs = zip(part.relations, factors, strict=True)
    return replace(part, relations=tuple(Relation(item.momentum, factor * item.rest) for item, factor in pairs))


@final
class _Point:
    """One random point at which the claim vanishes, and each fault is tried."""

    def __init__(
        self,
        tape: Tape,
        terms: Tape,
        symbols: Symbols,
        gains: Sequence[Group],
        faults: Sequence[_Fault],
        rng: random.Random,
    ) -> None:
        self._tape, self._gains, self._faults, self._rng = tape, gains, faults, rng
        for _ in range(ATTEMPTS):
            self._trial = Trial(random_prime(rng, BITS), rng)
            self._given = [residues(self._trial, group) for group in symbols.groups]
            own = {group.label: values for group, values in zip(symbols.groups, self._given, strict=True)}
            self._copies = [own[gain.label] for gain in gains]
            try:
                self._terms = terms.evaluate(self._given, self._trial)
                _, self._moves = self._at({}, {})
                return
            except ZeroDivision:
                continue
        raise ZeroDivision("a denominator vanishes at every random point")

    def _at(self, values: Mapping[str, int], copies: Mapping[str, list[int]]) -> list[list[int]]:
        chosen = [copies.get(gain.label, own) for gain, own in zip(self._gains, self._copies, strict=True)]
        factors = [[values.get(fault.name, 1) % self._trial.prime] for fault in self._faults]
        return self._tape.evaluate([*self._given, *chosen, *factors], self._trial)

    def matters(self, fault: _Fault) -> bool:
        """Its term is not identically zero."""
        return any(self._terms[self._faults.index(fault)])

    def refutes(self, fault: _Fault | Group) -> bool:
        """Something does not vanish with the fault."""
        if isinstance(fault, Group):
            return any(self._at({}, {fault.label: self._others(fault)})[0])
        return any(self._at({fault.name: fault.value}, {})[0])

    def moves_otherwise(self, gain: Group) -> bool:
        """What the states become depends on it."""
        return self._at({}, {gain.label: self._others(gain)})[1] != self._moves

    def _others(self, gain: Group) -> list[int]:
        return [self._trial.random() for _ in range(gain.symbol.numel())]
