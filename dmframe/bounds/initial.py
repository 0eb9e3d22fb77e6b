"""Storage at the start, term by term, in the parameters of a loop."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX, Square, Stored
from dmframe.block.model import symbols_in
from dmframe.block.port import Side
from dmframe.bounds.disturbed import NoBoundError
from dmframe.bounds.still import SLACK, nearest, still_of
from dmframe.certify.checked import Numbers
from dmframe.certify.claim import Claim
from dmframe.certify.starts import has_start, start_expression
from dmframe.certify.symbols import symbols_of
from dmframe.common.text import Text
from dmframe.prove.definite import lower


@final
@dataclass(frozen=True, eq=False)
class Initial:
    """A term of V at the start.

    Parameters
    ----------
    of
        The vector of the term.
    elements
        Half its square, element by element if its weight is diagonal, in parameters and starts with intervals.
    cascade
        True for a term of the task level.
    lowered_by
        Parameters of the controller that would lower it, such as ``a larger inverse.Lambda_I``.
    """

    block: str
    of: Text
    elements: tuple[SX, ...]
    cascade: bool
    lowered_by: Callable[[], tuple[str, ...]]


def initial_terms(claim: Claim, numbers: Numbers, start: Mapping[str, Any]) -> list[Initial]:
    """Each stored term at the start of a run: from the graph's own start, or on the path and at rest.

    The error of inertial parameters is the shortest one of those that give the same motions (`dmframe.bounds.still`).

    Raises `NoBoundError` for an initial value that neither the graph, nor a block, nor the path states.
    """
    begin = Begin(claim, numbers, start)
    return [
        Initial(part.block, term.of, tuple(begin.elements(term)), part.cascade, partial(begin.lowering, term))
        for part in claim.parts
        for term in part.stored
    ]


@final
class Begin:
    """Expressions at the initial state and at t = 0."""

    def __init__(self, claim: Claim, numbers: Numbers, start: Mapping[str, Any]) -> None:
        self._claim, self._numbers, self._start = claim, numbers, start

    def elements(self, term: Stored) -> list[SX]:
        """Half the term at the start, element by element for a diagonal weight."""
        if not isinstance(term, Square) or not ca.SX(term.weight).is_column():
            return [self.at(ca.SX(term.value) / 2)]
        error = ca.densify(term.vector)
        weights = self.at(ca.densify(term.weight * ca.SX.ones(error.shape[0])))
        found = self._shortest(term, self.at(error), weights)
        return list(ca.vertsplit(found * found * weights / 2))

    def _shortest(self, term: Square, error: SX, weights: SX) -> SX:
        """The error up to directions in which its adaptation law never moves."""
        still = still_of(self._claim, symbols_of(self._claim, self._numbers.uncertain), term)
        if still is None:
            return error
        p = self._claim.loop
        own = ca.Function("weights", [p.p], [weights])(p.p_values).full().ravel()
        found = ca.DM(nearest(still.directions, own)) @ error
        if still.box:
            true = self.at(still.estimate) - found
            inside = ca.vertcat(true - still.box[0], still.box[1] - true)
            if min(map(lower, self._numbers.enclosed(inside))) <= 0:
                return error
        return SLACK * found

    def at(self, expression: SX, kept: Container[str] = ()) -> SX:
        """The expression in parameters and in initial values with intervals; the states in `kept` stay symbols."""
        loop, value = self._claim.loop, self._claim.loop.joined([expression])[0]
        for _ in loop.variables:  # a start may depend on that of another state
            used = symbols_in([value])
            moved = [item for item in self._starts if item[0] not in kept and used & symbols_in([item[1]])]
            for label, _, at in moved:
                if at is None:
                    raise NoBoundError(f"{label}: its initial value is not known before a run")
            if moved:
                value = ca.substitute(value, ca.vertcat(*(x for _, x, _ in moved)), ca.vertcat(*(x for *_, x in moved)))
            value = ca.substitute(loop.on_path(value), loop.time, 0)
            if not moved:
                break
        known = self._numbers.known | symbols_in(self._claim.starts[label] for label in self._numbers.starts)
        known |= symbols_in(symbol for label, symbol, _ in self._starts if label in kept)
        if left := [symbol for symbol in ca.symvar(value) if symbol.element_hash() not in known]:
            raise NoBoundError(f"{left[0]}: its value at the start is not known")
        return value

    @cached_property
    def _starts(self) -> list[tuple[str, SX, SX | None]]:
        """Label, symbols and initial value of each state."""
        return [(v.label, ca.vec(v.symbol), self._of(v.label, v.symbol)) for v in self._claim.loop.variables]

    def _of(self, label: str, symbol: SX) -> SX | None:
        claim, numbers = self._claim, self._numbers
        if label in numbers.starts:
            return claim.starts[label]
        if not has_start(label, numbers, self._start):
            for pair in claim.loop.followed:  # a run computes the start on the path
                if pair.actual == label:
                    return ca.vec(ca.densify(pair.wanted))
                if symbols_in([pair.found]) & symbols_in([symbol]):
                    return None
        value = start_expression(label, numbers, self._start)
        return None if value is None else ca.vec(ca.densify(value))

    def lowering(self, term: Stored) -> tuple[str, ...]:
        """Gains and initial estimates of controllers on which a term depends, and how each lowers it at the graph."""
        claim = self._claim
        blocks, models = claim.diagram.blocks, claim.diagram.models
        guesses = {
            label: symbol
            for label, symbol, _ in self._starts
            if label.partition(".")[2] in models[label.partition(".")[0]].values
        }
        gains = {parameter.label: ca.vec(parameter.symbol) for parameter in claim.loop.parameters}
        value = self.at(ca.SX(term.value), guesses)
        given = ca.vertcat(ca.SX(0, 1), *guesses.values())
        numbers = [models[owner].values[name] for owner, _, name in (label.partition(".") for label in guesses)]
        point = np.concatenate([np.zeros(0), *(each.ravel(order="F") for each in numbers)])
        found = list[str]()
        for label, symbol in (gains | guesses).items():
            block = blocks.get(label.partition(".")[0])
            if block is None or block.side is not Side.CONTROLLER or not ca.depends_on(value, symbol):
                continue
            slope = ca.Function("slope", [claim.loop.p, given], [ca.gradient(value, symbol)])(
                claim.loop.p_values, point
            )
            steep = slope.full()
            if steep.any():
                how = "a larger" if (steep <= 0).all() else "a smaller" if (steep >= 0).all() else "another"
                found.append(f"{how} {label}")
        return tuple(found)
