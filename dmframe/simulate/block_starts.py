"""Initial states stated by blocks, as expressions, in an order in which they can be evaluated."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.block.faults import fault_context
from dmframe.block.steady import check_steady
from dmframe.common.errors import BlockError, StartError, listed
from dmframe.diagram import Diagram, Variable
from dmframe.diagram.closed_loop import columns, stack
from dmframe.diagram.view import stated_start, view

Made = dict[tuple[Any, ...], Any]
"""Cache of expressions and functions shared by all parameter values of a diagram."""


def once(made: Made, key: tuple[Any, ...], make: Callable[[], Any]) -> Any:
    """Cached value of a key, made on first use."""
    if key not in made:
        made[key] = make()
    return made[key]


def block_starts(diagram: Diagram, block: str, made: Made) -> Mapping[str, Any]:
    """Initial states stated by a block, as expressions."""

    def evaluate() -> Mapping[str, Any]:
        try:
            return _stated(diagram, block)
        except BlockError as fault:
            fault.path = fault.path or ("blocks", block)
            raise

    found: Mapping[str, Any] = once(made, ("stated", block), evaluate)
    return found


def _stated(diagram: Diagram, block: str) -> Mapping[str, Any]:
    seen, states = view(diagram, block), diagram.models[block].states
    with fault_context(block, "start()"):
        starts = diagram.blocks[block].composed_start(seen.u, seen.p, seen.truth)
    if not isinstance(starts, Mapping):
        raise BlockError(f"{block}: expected start() to return starts by state, found {type(starts).__name__}")
    first = {f"start of {name}": value for name, value in starts.items()}
    check_steady(block, diagram.blocks[block], "start() states", first, lambda other: stated_start(other, seen))
    for name in states.keys() & starts.keys():
        with fault_context(block, f"start() of {name}"):
            found, expected = ca.SX(starts[name]).numel(), states[name].numel()
        if found != expected:
            raise BlockError(f"{block}: expected start() to give {name} {expected} numbers, found {found}")
    return starts


def has_start(diagram: Diagram, variable: Variable, made: Made) -> bool:
    """True for a state whose block states its initial value."""
    return variable.name in block_starts(diagram, variable.block, made)


def in_order(diagram: Diagram, waiting: Sequence[Variable], made: Made) -> Iterator[tuple[Variable, SX | None]]:
    """Undetermined states with the stated expressions, ordered by dependency."""
    starts = dict[str, SX | None]()
    for variable in waiting:
        stated = block_starts(diagram, variable.block, made).get(variable.name)
        key = ("joined", variable.label)
        starts[variable.label] = None if stated is None else once(made, key, partial(_joined, diagram, stated))
    open_states = list(waiting)
    while open_states:
        symbols = {v.label: ca.vec(v.symbol) for v in open_states}

        def ready(variable: Variable, symbols: Mapping[str, SX] = symbols) -> bool:
            expression = starts[variable.label]
            return expression is None or not ca.depends_on(expression, stack(symbols.values()))

        free = [variable for variable in open_states if ready(variable)]
        if not free:
            names = listed([variable.label for variable in open_states])
            path = ("blocks", open_states[0].block)
            raise StartError(f"start: {names} depend on each other's start; give one of them under start", path=path)
        for variable in free:
            yield variable, starts[variable.label]
        open_states = [variable for variable in open_states if variable not in free]


def _joined(diagram: Diagram, expression: Any) -> Any:
    """Stated expression in states, parameters, time, random numbers and T."""
    loop = diagram.loop
    resolver = diagram.resolver
    leaves, meanings = columns([*resolver.trajectories.values(), *resolver.ahead.values()])  # some only for this start
    (joined,) = loop.joined([ca.substitute(loop.on_path(expression), leaves, meanings)])
    return ca.vec(joined)


def at_start(diagram: Diagram, joined: Any, known: Sequence[Variable]) -> Any:
    """(t, p, known states as one column, random numbers, T) -> stated initial value."""
    loop = diagram.loop
    inputs = [loop.time, loop.p, stack(v.symbol for v in known), loop.drawn, loop.period]
    return ca.Function("at_start", inputs, [joined])
