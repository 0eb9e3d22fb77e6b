"""States that a discrete-time proof bounds: by V, by a box, or by the map of a sample; the others are listed.

The map bounds a state if its next value is the state itself, or is defined everywhere and depends only on bounded
states and parameters. Continuous states, sources and random inputs are not analysed.
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
    """Sort all states of the loop, including the plant's."""
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


def states_in_v(claim: Claim) -> list[str]:
    """Labels of the states in V, to which the proof applies."""
    used = symbols_in([claim.V])
    return [label for label, symbol in claim.sample.symbols.items() if used & symbols_in([symbol])]


def _boxed(claim: Claim) -> set[str]:
    """States that are projected onto a bounded set at each sample."""
    loop = claim.loop
    found = {f"{part.block}.{item.estimate}" for part in claim.parts for item in part.certificate.steps if item.box}
    return found | {f"{item.block}.{item.of}" for item in loop.projections if item.set.bounds}


def _in_v(claim: Claim, numbers: Numbers, seed: int) -> set[str]:
    """States determined by the vectors of a V that does not increase, if the vectors are linear in them.

    A vector with a jump, such as x - floor(x), has a constant slope and is not linear.
    """
    own = [variable for variable in claim.loop.stepped if variable.label in claim.sample.symbols]
    states = stack(variable.symbol for variable in own)
    rng = random.Random(seed + 5)
    trial = Trial(random_prime(rng), rng)
    rows = Echelon(trial.prime, states.numel())
    for part in claim.parts:
        if part.certificate.residual or part.certificate.steps:
            continue  # V may increase by an unknown amount
        for term in part.certificate.storage:
            if jumps(ca.SX(term.vector), numbers.known):
                continue
            for row in _constant_rows(ca.jacobian(ca.SX(term.vector), states), numbers, trial):
                rows.add(row)
    columns = range(states.numel())
    return {variable.label for variable, part in rows_of(own) if rows.undetermined.isdisjoint(columns[part])}


def _constant_rows(slopes: SX, numbers: Numbers, trial: Trial) -> Iterator[list[int]]:
    """Rows of a matrix that are numbers of the graph."""
    for row in ca.vertsplit(slopes):
        try:
            values = numbers.of(row)
            if not any(isinstance(value, Interval) for value in values):
                yield [trial.residue(value) for value in values if not isinstance(value, Interval)]
        except (ValueFault, ZeroDivisionError, ZeroDivision):
            continue


def _becomes(claim: Claim) -> Iterator[tuple[str, tuple[SX, SX]]]:
    """Each state, and its next value; a continuous state only if it is constant."""
    loop = claim.loop
    moved = loop.joined([loop.advanced])[0]
    for variable, rows in rows_of(loop.stepped):
        yield variable.label, (ca.vec(variable.symbol), moved[rows])
    for variable in loop.flowing:
        if loop.joined(loop.rates_of([variable]))[0].is_zero():
            yield variable.label, (ca.vec(variable.symbol), ca.vec(variable.symbol))


def _needed(state: SX, then: SX) -> set[int]:
    """Symbols that must be bounded for a state to be bounded; none for a constant state."""
    stays = ca.is_equal(ca.densify(then), ca.densify(state), 2)
    return set() if stays else symbols_in([then])


def _is_defined(then: SX) -> bool:
    """True if a next value consists of operations that are defined everywhere."""
    return not any(symbols_in([part]) for _, part in domains_of([then]))
