"""Flatten resolved blocks to one `ClosedLoop`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from dmframe.block.certificate import SX
from dmframe.block.model import BlockModel, symbols_in
from dmframe.block.port import Side
from dmframe.diagram.closed_loop import ClosedLoop, Noise, Parameter, Signal, Variable
from dmframe.diagram.pieces import Leaf, loop_fault
from dmframe.diagram.resolve import Resolver
from dmframe.diagram.wiring import End, Wire


def flatten(resolver: Resolver, parameters: Sequence[Parameter]) -> ClosedLoop:
    """Resolve every rate and output of the diagram. Faults are collected in ``resolver.faults``."""
    sides: dict[Side, list[Variable]] = {side: [] for side in Side}
    outputs = list[Signal]()
    for name, model in resolver.models.items():
        for state in (state for state in model.block.states if state.name in model.states):
            rate, after = resolver.rate(name, state.name), resolver.next(name, state.name)
            leaf = model.states[state.name]
            moves = leaf, rate, after, state.recorded, resolver.second(name, state.name)
            sides[model.block.side].append(Variable(name, state.name, state.shape, state.unit, *moves))
        for port in model.block.outputs:
            if port.name in model.equations.outputs:
                expression = _output(resolver, model, port.name)
                own = model.block.side is Side.PLANT and not port.instead_of
                outputs.append(Signal(name, port.name, port.shape, port.unit, expression, own))
    drawn = {(name, port.name): port.drawn for name, model in resolver.models.items() for port in model.block.inputs}
    return ClosedLoop(
        time=resolver.time,
        period=resolver.period,
        controller=tuple(sides[Side.CONTROLLER]),
        plant=tuple(sorted(sides[Side.PLANT], key=lambda variable: not variable.sampled)),
        trajectories=tuple(resolver.trajectories.values()),
        ahead=tuple(resolver.ahead.values()),
        noises=tuple(Noise(".".join(end), leaf, drawn[end]) for end, leaf in resolver.drawn.items()),
        sampled_signals=_sampled_signals(resolver),
        projections=tuple(resolver.projections.values()),
        parameters=tuple(parameters),
        outputs=tuple(outputs),
        paced=frozenset(name for name in resolver.models if resolver.paced(name)),
        led=tuple(dict.fromkeys(_led(resolver))),
    )


def _led(resolver: Resolver) -> Iterator[tuple[str, str]]:
    """Outputs s of the plant with the reference s_d of a controller block, if one block reads both."""
    for (name, port), goal in resolver.sources.items():
        actual = resolver.sources.get((name, port.removesuffix("_d")))
        if port.endswith("_d") and isinstance(goal, Wire) and isinstance(actual, Wire):
            sides = resolver.models[actual.block].block.side, resolver.models[goal.block].block.side
            if sides == (Side.PLANT, Side.CONTROLLER):
                true = _replaced_signal(resolver, actual)  # not the sensor that replaces it
                yield f"{true.block}.{true.port}", f"{goal.block}.{goal.port}"


def _replaced_signal(resolver: Resolver, wire: Wire) -> Wire:
    """The signal that channel models replace."""
    block = resolver.models[wire.block].block
    port = next(port for port in block.outputs if port.name == wire.port)
    before = resolver.sources.get((wire.block, port.instead_of)) if port.instead_of else None
    return _replaced_signal(resolver, before) if isinstance(before, Wire) else wire


def _output(resolver: Resolver, model: BlockModel, port: str) -> SX:
    """An output; that of a source is its trajectory, which remains a leaf."""
    if resolver.side(model.name) is Side.SOURCE:
        return resolver.trajectory(model.name, port, 0).symbol
    return resolver.output(model.name, port)


def _cycle(needs: Mapping[End, Sequence[End]]) -> list[End]:
    """A cycle of signals, each of which depends on at least one other."""
    cycle = [next(iter(needs))]
    while cycle[-1] not in cycle[:-1]:
        cycle.append(needs[cycle[-1]][0])
    return cycle[cycle.index(cycle[-1]) :]


def _sampled_signals(resolver: Resolver) -> tuple[Leaf, ...]:
    """Measured and commanded signals with their expressions in the leaves of their sides, in order of evaluation."""
    waiting = dict[End, tuple[Leaf, SX]]()
    while missing := resolver.sampled_signals.keys() - waiting.keys():  # resolving one may find another
        waiting |= {end: (resolver.sampled_signals[end], resolver.output(*end)) for end in sorted(missing)}
    symbols = {end: leaf.identities for end, (leaf, _) in waiting.items()}
    used = {end: symbols_in([expression]) for end, (_, expression) in waiting.items()}
    done = list[Leaf]()
    while waiting:
        needs = {end: [other for other in waiting if symbols[other] & used[end]] for end in waiting}
        ready = [end for end, others in needs.items() if not others]
        if not ready:
            resolver.faults.append(loop_fault([".".join(end) for end in _cycle(needs)]))
            break
        for end in ready:
            leaf, expression = waiting.pop(end)
            done.append(leaf.standing_for(expression))
    return tuple(done)
