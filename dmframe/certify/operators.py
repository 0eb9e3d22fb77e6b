"""The operator D of a claim: d/dt along the closed loop, or the difference over a sample.

    flow:    D S = dS/dt along dx/dt = f(x, t),
    sample:  D S = S(x+) - S(x),  x+ = g(x)

Both take f and g from `ClosedLoop`, as a run does.
"""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from functools import cached_property
from typing import final

import casadi as ca

from dmframe.block.model import symbols_in
from dmframe.certificate import SX
from dmframe.certify.differentiated import Record
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack


@final
class Flow:
    """d/dt along the closed loop's vector field, measured and commanded signals substituted.

    Every derivative is entered in the record.
    """

    def __init__(self, diagram: Diagram, record: Record | None = None) -> None:
        self.diagram, self.loop, self.record = diagram, diagram.loop, Record() if record is None else record
        loop = self.loop
        variables = loop.variables
        self._leaves = [loop.time, *(variable.symbol for variable in variables)]
        self._rates = [ca.SX(1), *loop.joined(loop.rates_of(variables))]
        self._labels = ["", *(variable.label for variable in variables)]

    def D(self, expression: SX, of: str) -> SX:
        """d/dt along the closed loop; trajectories and their derivatives are free."""
        self.record.add(of, expression)
        return self.unrecorded(expression)

    def rates_of(self, used: AbstractSet[int]) -> dict[str, SX]:
        """The rates of the states, the time and the trajectories among these symbols, by label."""
        labels = ["t", *self._labels[1:]]
        rates = {
            label: ca.vec(ca.densify(rate))
            for label, leaf, rate in zip(labels, self._leaves, self._rates, strict=True)
            if used & symbols_in([leaf])
        }
        for (block, port, order), leaf in list(self.diagram.resolver.trajectories.items()):
            if used & symbols_in([leaf.symbol]):
                rates[leaf.name] = self.diagram.resolver.trajectory_rate(block, port, order)
        return rates

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

    def __init__(self, diagram: Diagram) -> None:
        self.diagram, self.loop, self.record = diagram, diagram.loop, Record()

    @cached_property
    def next(self) -> Mapping[str, SX]:
        """Each sampled state at the next sample, by label, measured and commanded signals substituted."""
        own = self.loop.becomes()
        return dict(zip(own, self.loop.crossed(list(own.values())), strict=True))

    @cached_property
    def symbols(self) -> Mapping[str, SX]:
        """The sampled states, by label."""
        return {v.label: v.symbol for v in self.loop.stepped if v.sampled}

    def plant_rates(self, used: AbstractSet[int]) -> dict[str, SX]:
        """The rates of these states of the plant between two samples, commands free, by label."""
        loop = self.loop
        known = [(leaf.symbol, leaf.expression) for leaf in loop.measured]
        moving = [variable for variable in loop.flowing if used & symbols_in([variable.symbol])]
        rates = loop.rates_of(moving)
        if known:
            rates = ca.substitute(rates, [stack(a for a, _ in known)], [stack(b for _, b in known)])
        return {v.label: ca.vec(ca.densify(rate)) for v, rate in zip(moving, rates, strict=True)}


__all__ = ["Flow", "Sample"]
