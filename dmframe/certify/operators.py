"""The operator D of a claim: d/dt along the closed loop, or the difference over a sample.

    flow:    D S = dS/dt along dx/dt = f(x, t),
    sample:  D S = S(x+) - S(x),  x+ = g(x)

Both take f and g from `ClosedLoop`, as a run does.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from collections.abc import Set as AbstractSet
from functools import cached_property
from typing import final

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.certify.differentiated import Record
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack


@final
class Flow:
    """d/dt along the closed loop's vector field, with measured and commanded signals substituted.

    Every derivative is entered in the record.
    """

    def __init__(self, diagram: Diagram, record: Record | None = None) -> None:
        self.diagram, self.loop, self.record = diagram, diagram.loop, Record() if record is None else record
        variables = self.loop.variables
        rates = [ca.SX(1), *self.loop.joined(self.loop.rates_of(variables))]
        leaves = [("t", self.loop.time), *((variable.label, variable.symbol) for variable in variables)]
        self._own = [(label, leaf, rate) for (label, leaf), rate in zip(leaves, rates, strict=True)]

    def D(self, expression: SX, of: str) -> SX:
        """d/dt along the closed loop; trajectories and their derivatives are free."""
        self.record.add(of, expression)
        return self.unrecorded(expression)

    def rates_of(self, used: AbstractSet[int]) -> dict[str, SX]:
        """Rates of the states, the time and the trajectories among these symbols, by label."""
        return {label: ca.vec(ca.densify(rate)) for label, _, rate in self._moving(used)}

    def unrecorded(self, expression: SX) -> SX:
        """The same without an entry, for expressions that the caller examines separately."""
        moving = list(self._moving(symbols_in([expression])))
        if not moving:
            return ca.SX(0)
        return ca.jtimes(expression, stack(leaf for _, leaf, _ in moving), stack(rate for *_, rate in moving))

    def _moving(self, used: AbstractSet[int]) -> Iterator[tuple[str, SX, SX]]:
        """Label, symbol and rate of the varying symbols; the rate of a trajectory may be a new symbol."""
        yield from (item for item in self._own if used & symbols_in([item[1]]))
        for (block, port, order), leaf in list(self.diagram.resolver.trajectories.items()):
            if used & leaf.identities:
                yield leaf.name, leaf.symbol, self.diagram.resolver.trajectory_rate(block, port, order)


@final
class Sample:
    """Difference over a sample of the sampled states; all others keep their symbols, which a claim must not contain."""

    def __init__(self, diagram: Diagram) -> None:
        self.diagram, self.loop, self.record = diagram, diagram.loop, Record()

    @cached_property
    def next(self) -> Mapping[str, SX]:
        """Each sampled state at the next sample, by label, with measured and commanded signals substituted."""
        own = self.loop.becomes()
        return dict(zip(own, self.loop.crossed(list(own.values())), strict=True))

    @cached_property
    def symbols(self) -> Mapping[str, SX]:
        """The sampled states, by label."""
        return {v.label: v.symbol for v in self.loop.stepped if v.sampled}

    def plant_rates(self, used: AbstractSet[int]) -> dict[str, SX]:
        """Rates of these states of the plant between two samples, for free commands, by label."""
        loop = self.loop
        known = [(leaf.symbol, leaf.expression) for leaf in loop.measured]
        moving = [variable for variable in loop.flowing if used & variable.identities]
        rates = loop.rates_of(moving)
        if known:
            rates = ca.substitute(rates, [stack(a for a, _ in known)], [stack(b for _, b in known)])
        return {v.label: ca.vec(ca.densify(rate)) for v, rate in zip(moving, rates, strict=True)}


__all__ = ["Flow", "Sample"]
