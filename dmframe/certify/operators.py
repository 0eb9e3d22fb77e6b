"""The operator D of a claim: d/dt along the closed loop, or the difference over a sample.

    flow:    D S = dS/dt along dx/dt = f(x, t),
    sample:  D S = S(x+) - S(x),  x+ = g(x)

Both take f and g from `ClosedLoop`, as a run does. A fault is an operator whose rates, or whose moves x+ - x, have
another sign or other parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from functools import cached_property
from typing import ClassVar, Protocol, final

import casadi as ca

from dmframe.block.model import symbols_in
from dmframe.certificate import SX
from dmframe.certify.differentiated import Record
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack


class Operator(Protocol):
    """D, and the faults that can be put into what moves the states."""

    name: ClassVar[str]
    """How D V is printed."""

    flip: ClassVar[str]
    """Name of the fault that reverses a state's move."""

    record: Record

    def D(self, expression: SX, of: str) -> SX:
        """D of an expression; `of` names it in the record."""

    def with_parameters(self, symbols: SX, others: SX) -> Operator:
        """The operator with other parameters in the equations."""

    def with_factors(self, factors: Mapping[str, SX]) -> Operator:
        """The operator with the moves of these states, by label, multiplied."""

    def moves(self, labels: Sequence[str]) -> SX:
        """The rates, or the next values, of these states, a column."""


@final
class Flow:
    """d/dt along the closed loop's vector field, measured and commanded signals substituted.

    Every derivative is entered in the record; that of a faulty field in one of its own.
    """

    name: ClassVar[str] = "dV/dt"
    flip: ClassVar[str] = "sign of d {}/dt flipped"

    def __init__(self, diagram: Diagram, record: Record | None = None) -> None:
        self.diagram, self.loop, self.record = diagram, diagram.loop, Record() if record is None else record
        loop = self.loop
        variables = loop.variables
        self._leaves = [loop.time, *(variable.symbol for variable in variables)]
        self._rates = [ca.SX(1), *loop.joined(loop.rates_of(variables))]
        self._labels = ["", *(variable.label for variable in variables)]

    def _with(self, rates: Sequence[SX]) -> Flow:
        """Another field, with a record of its own."""
        field = copy(self)
        field._rates, field.record = list(rates), Record()
        return field

    def with_parameters(self, symbols: SX, others: SX) -> Flow:
        """The same field with other parameters in its equations."""
        return self._with(ca.substitute(self._rates, [symbols], [others]) if symbols.numel() else self._rates)

    def with_factors(self, factors: Mapping[str, SX]) -> Flow:
        """The same field with the rates of these states, by label, multiplied."""
        named = zip(self._labels, self._rates, strict=True)
        return self._with([rate * factors[label] if label in factors else rate for label, rate in named])

    def D(self, expression: SX, of: str) -> SX:
        """d/dt along the closed loop; trajectories and their derivatives are free."""
        self.record.add(of, expression)
        return self.unrecorded(expression)

    def moves(self, labels: Sequence[str]) -> SX:
        """The rates of these states."""
        rates = dict(zip(self._labels, self._rates, strict=True))
        return stack(rates[label] for label in labels)

    def unrecorded(self, expression: SX) -> SX:
        """The same of what the caller examines itself, or has examined as a part."""
        used = symbols_in([expression])
        pairs = [
            (leaf, rate) for leaf, rate in zip(self._leaves, self._rates, strict=True) if used & symbols_in([leaf])
        ]
        for (block, port, order), leaf in list(self.diagram.resolver.trajectories.items()):
            if used & symbols_in([leaf.symbol]):
                pairs.append((leaf.symbol, self.diagram.resolver.trajectory_rate(block, port, order)))
        if not pairs:
            return ca.SX(0)
        return ca.jtimes(expression, stack(leaf for leaf, _ in pairs), stack(rate for _, rate in pairs))


@final
class Sample:
    """The difference over a sample of the sampled states; all others keep their symbols, which a claim may not hold."""

    name: ClassVar[str] = "V(next) - V"
    flip: ClassVar[str] = "{}: its move reversed"

    def __init__(self, diagram: Diagram, becomes: Mapping[str, SX] | None = None) -> None:
        self.diagram, self.loop, self.record = diagram, diagram.loop, Record()
        self._given = becomes

    @cached_property
    def next(self) -> Mapping[str, SX]:
        """Each sampled state at the next sample, by label, measured and commanded signals substituted."""
        if self._given is not None:
            return self._given
        own = self.loop.becomes()
        return dict(zip(own, self.loop.crossed(list(own.values())), strict=True))

    @cached_property
    def symbols(self) -> Mapping[str, SX]:
        """The sampled states, by label."""
        return {v.label: v.symbol for v in self.loop.stepped if v.sampled}

    def with_parameters(self, symbols: SX, others: SX) -> Sample:
        """The same map with other parameters in its equations."""
        if not symbols.numel():
            return self
        values = ca.substitute(list(self.next.values()), [symbols], [others])
        return Sample(self.diagram, dict(zip(self.next, values, strict=True)))

    def with_factors(self, factors: Mapping[str, SX]) -> Sample:
        """The same map with the moves of these states multiplied."""
        moved = {
            label: self.symbols[label] + factors[label] * (then - self.symbols[label]) if label in factors else then
            for label, then in self.next.items()
        }
        return Sample(self.diagram, moved)

    def D(self, expression: SX, of: str) -> SX:
        """The expression one sample later, minus the expression."""
        del of  # nothing is differentiated
        used = symbols_in([expression])
        labels = [label for label, symbol in self.symbols.items() if used & symbols_in([symbol])]
        if not labels:
            return ca.SX.zeros(expression.shape)
        old, new = stack(self.symbols[label] for label in labels), stack(self.next[label] for label in labels)
        return ca.substitute([expression], [old], [new])[0] - expression

    def moves(self, labels: Sequence[str]) -> SX:
        """The next values of these states."""
        return stack(self.next[label] for label in labels)

    def along_the_plant(self, expression: SX) -> SX:
        """d/dt while the plant moves between two samples, its commands free."""
        loop = self.loop
        known = [(leaf.symbol, leaf.expression) for leaf in loop.measured]
        moving = [variable for variable in loop.flowing if symbols_in([expression]) & symbols_in([variable.symbol])]
        if not moving:
            return ca.SX.zeros(expression.shape)
        rates = loop.rates_of(moving)
        if known:
            rates = ca.substitute(rates, [stack(a for a, _ in known)], [stack(b for _, b in known)])
        return ca.jtimes(expression, stack(variable.symbol for variable in moving), stack(rates))


__all__ = ["Flow", "Operator", "Sample"]
