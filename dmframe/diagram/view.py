"""A block's symbols as the whole diagram sees them: for its start and its certificate, which look behind the wall."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

from dmframe.block import Signals
from dmframe.certificate import SX
from dmframe.diagram.diagram import Diagram
from dmframe.diagram.wiring import same_unit
from dmframe.port import Port


@final
@dataclass(frozen=True)
class View:
    """u, x, p and truth of one block, each signal expanded to the diagram's leaves."""

    u: Signals
    x: Signals
    p: Signals
    truth: Signals


def view(diagram: Diagram, name: str, known: Mapping[str, SX] | None = None) -> View:
    """The view of a block; `known` holds true values that other blocks' certificates state, such as a_d.

    A truth that the diagram does not have is left out; reading it raises `BlockError`.
    """
    model, resolver = diagram.models[name], diagram.resolver
    _, x, p = model.signals()
    u = Signals(name, "inputs", {port: resolver.input(name, port) for port in model.inputs})
    truth = dict[str, SX]()
    for port in model.block.truth:
        expression = _truth(diagram, name, port, truth, known or {})
        if expression is not None:
            truth[port.name] = expression
    return View(u, x, p, Signals(name, "truths that this diagram has", truth))


def _truth(diagram: Diagram, reader: str, port: Port, found: Mapping[str, SX], known: Mapping[str, SX]) -> SX | None:
    if port.name in known:
        return known[port.name]
    for name, model in diagram.models.items():
        for other in model.block.outputs:
            if other.name == port.name and other.name in model.equations.outputs and same_unit(other, port):
                return diagram.resolver.output(name, port.name)
    if port.derivative_of in found:
        return diagram.resolver.derivative(found[port.derivative_of], f"{reader}.{port.name}")
    return None
