"""A block's signals expanded over the whole diagram, for its initial values and its certificate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import casadi as ca

from dmframe.block import AbstractBlock, Signals
from dmframe.block.base import TRUE_VALUES
from dmframe.block.certificate import SX
from dmframe.block.port import Input
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.diagram import Diagram
from dmframe.diagram.truths import Stated, owner_of, value_of


@final
@dataclass(frozen=True)
class View:
    """u, x, p and truth of one block, each signal expanded to the diagram's leaves.

    `owners` are the blocks of the true values.
    """

    u: Signals
    x: Signals
    p: Signals
    truth: Signals
    owners: Mapping[str, str]


def view(diagram: Diagram, name: str, stated: Stated | None = None) -> View:
    """The view of a block; `stated` contains true values from other blocks' certificates, such as a_d.

    A true value that the diagram does not have is omitted; reading it raises `BlockError`. A true value of several
    blocks raises it too if wires do not determine one (`dmframe.diagram.truths`).
    """
    model, resolver = diagram.models[name], diagram.resolver
    _, x, p = model.signals()
    u = Signals(name, "inputs", {port: _settled(diagram, resolver.input(name, port)) for port in model.inputs})
    owners = owners_of(diagram, name, stated or {})
    truth = dict[str, SX]()
    for port in model.block.truth:
        expression = _truth(diagram, name, port, owners, truth, stated or {})
        if expression is not None:
            truth[port.name] = expression
    return View(u, x, p, Signals(name, TRUE_VALUES, truth), owners)


def stated_start(block: AbstractBlock, seen: View) -> dict[str, Any]:
    """Initial values of a block's states, by a description of each, ``start of z``."""
    starts: Any = block.composed_start(seen.u, seen.p, seen.truth)
    return (
        {f"start of {name}": value for name, value in starts.items()}
        if isinstance(starts, Mapping)
        else {"start": starts}
    )


def _settled(diagram: Diagram, expression: SX) -> SX:
    """The expression without the leaves of signals that cross sides for this reader only; the loop has none of them."""
    resolver, built = diagram.resolver, {leaf.name for leaf in diagram.loop.sampled_signals}
    for _ in range(len(diagram.blocks)):
        late = [
            (leaf.symbol, resolver.output(*end))
            for end, leaf in list(resolver.sampled_signals.items())
            if leaf.name not in built and ca.depends_on(expression, leaf.symbol)
        ]
        if not late:
            break
        leaves, meanings = (stack(part) for part in zip(*late, strict=True))
        (expression,) = ca.substitute([expression], [leaves], [meanings])
    return expression


def owners_of(diagram: Diagram, name: str, stated: Stated) -> dict[str, str]:
    """The owner of each true value that a block's proof reads; values without an owner are omitted."""
    found = {port.name: owner_of(diagram, name, port, stated) for port in diagram.blocks[name].truth}
    return {port: owner for port, owner in found.items() if owner is not None}


def _truth(
    diagram: Diagram, reader: str, port: Input, owners: Mapping[str, str], found: Mapping[str, SX], stated: Stated
) -> SX | None:
    if port.name in owners:
        return value_of(diagram, owners[port.name], port.name, stated)
    if port.derivative_of in found:
        return diagram.resolver.derivative(found[port.derivative_of], f"{reader}.{port.name}")
    return None
