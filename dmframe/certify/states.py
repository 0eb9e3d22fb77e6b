"""Which states a proof over samples bounds: what V, a box or the map of a sample itself keeps; the others are named.

A state follows from the map where its next value is its own, or is defined everywhere and made of bounded states and
parameters alone. Nothing is known of what moves between samples, of a source, or of what is drawn.
"""

from __future__ import annotations

import random
from collections.abc import Iterator

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.certify.checked import Numbers
from dmframe.certify.claim import Claim
from dmframe.certify.partial_functions import domains_of
from dmframe.certify.smoothness import jumps
from dmframe.certify.statements import States
from dmframe.common.errors import ValueFault
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.pieces import rows_of
from dmframe.exact import Trial, ZeroDivision, random_prime
from dmframe.exact.linear import Echelon
from dmframe.exact.rational import Interval


def sampled_states(claim: Claim, numbers: Numbers, seed: int) -> States:
    """Sort all states of the loop, the plant's too."""
    known = _boxed(claim) | _in_v(claim, numbers, seed)
    becomes = {label: pair for label, pair in _becomes(claim) if label not in known}
    needed = {label: _needed(*pair) for label, pair in becomes.items()}
    still = claim.loop.constants | symbols_in([claim.loop.period])
    while True:
        bounded = still | symbols_in(v.symbol for v in claim.loop.variables if v.label in known)
        ready = [label for label, symbols in needed.items() if symbols <= bounded]
        found = {label for label in ready if not needed.pop(label) or _is_defined(becomes[label][1])}
        if not found:
            break
        known |= found
    labels = [variable.label for variable in claim.loop.variables]
    return States(tuple(x for x in labels if x in known), (), tuple(x for x in labels if x not in known))


def held_in_v(claim: Claim) -> list[str]:
    """The labels of the states that V holds, of which the proof is."""
    used = symbols_in([claim.V])
    return [label for label, symbol in claim.sample.symbols.items() if used & symbols_in([symbol])]


def _boxed(claim: Claim) -> set[str]:
    """What is put back into a bounded set at each sample."""
    loop = claim.loop
    found = {f"{part.block}.{item.estimate}" for part in claim.parts for item in part.certificate.steps if item.box}
    return found | {f"{item.block}.{item.of}" for item in loop.projections if item.set.bounds}


def _in_v(claim: Claim, numbers: Numbers, seed: int) -> set[str]:
    """What a V that never rises holds: the states that its vectors, linear in them, determine.

    A vector with a jump, such as x - floor(x), has a constant slope and is not linear.
    """
    own = [variable for variable in claim.loop.stepped if variable.label in claim.sample.symbols]
    states = stack(variable.symbol for variable in own)
    rng = random.Random(seed + 5)
    trial = Trial(random_prime(rng), rng)
    rows = Echelon(trial.prime, states.numel())
    for part in claim.parts:
        if part.certificate.residual or part.certificate.steps:
            continue  # V rises by what is gained, of which nothing is known
        for term in part.certificate.storage:
            if jumps(ca.SX(term.vector), numbers.known):
                continue
            for row in _constant_rows(ca.jacobian(ca.SX(term.vector), states), numbers, trial):
                rows.add(row)
    columns = range(states.numel())
    return {variable.label for variable, part in rows_of(own) if rows.undetermined.isdisjoint(columns[part])}


def _constant_rows(slopes: SX, numbers: Numbers, trial: Trial) -> Iterator[list[int]]:
    """The rows of a matrix that are numbers of the graph."""
    for row in ca.vertsplit(slopes):
        try:
            values = numbers.of(row)
            if not any(isinstance(value, Interval) for value in values):
                yield [trial.residue(value) for value in values if not isinstance(value, Interval)]
        except (ValueFault, ZeroDivisionError, ZeroDivision):
            continue


def _becomes(claim: Claim) -> Iterator[tuple[str, tuple[SX, SX]]]:
    """Each state, and what it is one sample later; of one that moves between samples, only where it never does."""
    loop = claim.loop
    moved = loop.joined([loop.advanced])[0]
    for variable, rows in rows_of(loop.stepped):
        yield variable.label, (ca.vec(variable.symbol), moved[rows])
    for variable in loop.flowing:
        if loop.joined(loop.rates_of([variable]))[0].is_zero():
            yield variable.label, (ca.vec(variable.symbol), ca.vec(variable.symbol))


def _needed(state: SX, then: SX) -> set[int]:
    """The symbols that must be bounded for a state to be so; one that stays needs none."""
    stays = ca.is_equal(ca.densify(then), ca.densify(state), 2)
    return set() if stays else symbols_in([then])


def _is_defined(then: SX) -> bool:
    """True where operations that are defined everywhere make a next value."""
    return not any(symbols_in([part]) for _, part in domains_of([then]))
