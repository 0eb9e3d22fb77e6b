"""The flattened diagram: one vector field, with every gain and every true parameter a named symbol."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

import casadi as ca
import numpy as np

from dmframe.block.model import BlockModel, symbols_in
from dmframe.certificate import SX
from dmframe.diagram.projection import Projection
from dmframe.diagram.resolve import Leaf, Resolver, loop_fault
from dmframe.diagram.wiring import End
from dmframe.port import Side


@final
@dataclass(frozen=True)
class Variable:
    """A state of the closed loop; `shape` in letters, as declared."""

    block: str
    name: str
    shape: str
    unit: str
    symbol: SX
    rate: SX

    @property
    def label(self) -> str:
        """``block.state``."""
        return f"{self.block}.{self.name}"


@final
@dataclass(frozen=True)
class Signal:
    """An output of a block."""

    block: str
    name: str
    shape: str
    unit: str
    expression: SX

    @property
    def label(self) -> str:
        """``block.port``."""
        return f"{self.block}.{self.name}"


@final
@dataclass(frozen=True)
class Parameter:
    """A gain, a true parameter or a number of the robot: `symbol` in expressions, `value` in a run."""

    label: str
    symbol: SX
    value: np.ndarray
    unit: str


@final
@dataclass(frozen=True)
class ClosedLoop:
    """x' = F(t, x, p) and the sampled update, from the one set of block equations.

    The rates of `controller` and `plant`, and the `outputs`, stand in leaves: states, parameters,
    `trajectories`, projections' corrections, and `crossings`, the measured and commanded signals. `joined` puts
    the crossings' expressions in place.
    """

    time: SX
    controller: tuple[Variable, ...]
    plant: tuple[Variable, ...]
    trajectories: tuple[Leaf, ...]
    crossings: tuple[Leaf, ...]
    projections: tuple[Projection, ...]
    parameters: tuple[Parameter, ...]
    outputs: tuple[Signal, ...]

    def joined(self, expressions: Sequence[SX]) -> list[SX]:
        """Expressions with the wall taken away: measured and commanded signals replaced by what they are."""
        if not self.crossings:
            return list(expressions)
        leaves, meanings = self._crossed
        return list(ca.substitute(list(expressions), [leaves], [meanings]))

    @cached_property
    def _crossed(self) -> tuple[SX, SX]:
        return columns(self.crossings)

    @cached_property
    def state(self) -> SX:
        """The controller's states, then the plant's, as one column."""
        return stack(variable.symbol for variable in (*self.controller, *self.plant))

    @cached_property
    def p(self) -> SX:
        """All parameters as one column."""
        return stack(parameter.symbol for parameter in self.parameters)

    @property
    def p_values(self) -> np.ndarray:
        """Their values, in the same order (matrices column by column)."""
        parts = [parameter.value.ravel(order="F") for parameter in self.parameters]
        return np.concatenate(parts) if parts else np.zeros(0)


def stack(items: Iterable[SX]) -> SX:
    """Expressions of any size as one dense column."""
    return ca.densify(ca.veccat(ca.SX(0, 1), *items))


def columns(leaves: Sequence[Leaf]) -> tuple[SX, SX]:
    """The leaves' symbols, and their expressions, each as one column."""
    return stack(leaf.symbol for leaf in leaves), stack(leaf.expression for leaf in leaves)


def flatten(resolver: Resolver, parameters: Sequence[Parameter]) -> ClosedLoop:
    """Resolve every rate and output of the diagram. Faults are left in ``resolver.faults``."""
    sides: dict[Side, list[Variable]] = {side: [] for side in Side}
    outputs = list[Signal]()
    for name, model in resolver.models.items():
        for state in (state for state in model.block.states if state.name in model.states):
            rate = resolver.rate(name, state.name)
            leaf = model.states[state.name]
            sides[model.block.side].append(Variable(name, state.name, state.shape, state.unit, leaf, rate))
        for port in model.block.outputs:
            if port.name in model.equations.outputs:
                expression = _output(resolver, model, port.name)
                outputs.append(Signal(name, port.name, port.shape, port.unit, expression))
    return ClosedLoop(
        time=resolver.time,
        controller=tuple(sides[Side.CONTROLLER]),
        plant=tuple(sides[Side.PLANT]),
        trajectories=tuple(resolver.trajectories.values()),
        crossings=_crossings(resolver),
        projections=tuple(resolver.projections.values()),
        parameters=tuple(parameters),
        outputs=tuple(outputs),
    )


def _output(resolver: Resolver, model: BlockModel, port: str) -> SX:
    """An output; a source's is its trajectory, which stays a leaf."""
    if model.block.side is Side.SOURCE:
        return resolver.trajectory(model.name, port, 0).symbol
    return resolver.output(model.name, port)


def _cycle(needs: Mapping[End, Sequence[End]]) -> list[End]:
    """A closed way through signals that each need at least one other."""
    way = [next(iter(needs))]
    while way[-1] not in way[:-1]:
        way.append(needs[way[-1]][0])
    return way[way.index(way[-1]) :]


def _crossings(resolver: Resolver) -> tuple[Leaf, ...]:
    """Measured and commanded signals with their expressions, free of one another, in the order of need."""
    waiting = dict[End, tuple[Leaf, SX]]()
    while missing := resolver.crossings.keys() - waiting.keys():  # resolving one may find another
        waiting |= {end: (resolver.crossings[end], resolver.output(*end)) for end in sorted(missing)}
    symbols = {end: symbols_in([leaf.symbol]) for end, (leaf, _) in waiting.items()}
    done = list[Leaf]()
    while waiting:
        ready = [
            end
            for end, (_, expression) in waiting.items()
            if not any(symbols[other] & symbols_in([expression]) for other in waiting)
        ]
        if not ready:
            needs = {
                end: [other for other in waiting if symbols[other] & symbols_in([expression])]
                for end, (_, expression) in waiting.items()
            }
            resolver.faults.append(loop_fault([".".join(end) for end in _cycle(needs)]))
            break
        for end in ready:
            leaf, expression = waiting.pop(end)
            if done:
                leaves, meanings = columns(done)
                expression = ca.substitute([expression], [leaves], [meanings])[0]
            done.append(Leaf(leaf.name, leaf.side, leaf.symbol, expression))
    return tuple(done)
