"""Signal flow through a diagram: order of the blocks, and inputs and outputs of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

from dmframe.block.port import ANY, Access, Side
from dmframe.diagram import Diagram
from dmframe.diagram.wiring import Ahead, Derived, Drawn, End, Period, Time, Wire, Zero

SIDES: Final = (Side.SOURCE, Side.CONTROLLER, Side.PLANT)
"""Sides in signal-flow order."""


@final
@dataclass(frozen=True)
class Taken:
    """Input of a block, with the block and output that drive it (empty: none).

    `how` names the origin of its value: ``measured``, ``commanded``, ``wired``, ``derivative``, ``time``, ``period``,
    ``drawn``, ``ahead`` or ``zero``. For a derivative, `signal` is the differentiated input.
    """

    name: str
    unit: str
    how: str
    block: str = ""
    signal: str = ""


@final
@dataclass(frozen=True)
class Given:
    """Output of a block with its access and its readers (pairs of block and port)."""

    name: str
    unit: str
    access: Access
    readers: tuple[End, ...]


def order(diagram: Diagram) -> list[str]:
    """Blocks in signal-flow order: sources, controller, plant; within a side by direct feed-through."""
    known = dict[End, int]()
    places = {name: place for place, name in enumerate(diagram.blocks)}

    def depth(name: str) -> int:
        outputs = diagram.models[name].equations.outputs
        return max((_depth(diagram, (name, port), known) for port in outputs), default=0)

    return sorted(diagram.blocks, key=lambda name: (SIDES.index(diagram.blocks[name].side), depth(name), places[name]))


def _depth(diagram: Diagram, end: End, known: dict[End, int]) -> int:
    """Length of the longest direct feed-through chain to an output within its side."""
    if end in known:
        return known[end]
    known[end] = 0  # a derivative may lead back to itself
    name, port = end
    model = diagram.models[name]
    behind = [0]
    for need in model.needs(model.equations.outputs[port]):
        source = diagram.sources[name, need]
        while isinstance(source, Derived):
            source = diagram.sources[name, source.of]
        if isinstance(source, Wire) and diagram.blocks[source.block].side is diagram.blocks[name].side:
            behind.append(_depth(diagram, (source.block, source.port), known))
    known[end] = 1 + max(behind)
    return known[end]


def taken(diagram: Diagram, name: str) -> list[Taken]:
    """Inputs of a block, in the order of its ports."""
    return [_taken(diagram, name, port.name, port.unit) for port in diagram.blocks[name].inputs]


def _taken(diagram: Diagram, name: str, port: str, unit: str) -> Taken:
    match diagram.sources[name, port]:
        case Wire(block, signal):
            if unit == ANY:
                unit = next(item.unit for item in diagram.blocks[block].outputs if item.name == signal)
            return Taken(port, unit, _how(diagram, block, name), block, signal)
        case Derived(of):
            return Taken(port, unit, "derivative", signal=of)
        case Time():
            return Taken(port, unit, "time")
        case Period():
            return Taken(port, unit, "period")
        case Drawn():
            return Taken(port, unit, "drawn")
        case Ahead(of):
            source = diagram.sources[name, of]
            return Taken(port, unit, "ahead", source.block if isinstance(source, Wire) else "")
        case Zero():
            return Taken(port, unit, "zero")


def _how(diagram: Diagram, block: str, reader: str) -> str:
    sides = (diagram.blocks[block].side, diagram.blocks[reader].side)
    known = {(Side.PLANT, Side.CONTROLLER): "measured", (Side.CONTROLLER, Side.PLANT): "commanded"}
    return known.get(sides, "wired")


def given(diagram: Diagram, name: str) -> list[Given]:
    """Outputs of a block, in the order of its ports, without optional outputs that it omits."""
    there = diagram.models[name].equations.outputs
    return [
        Given(port.name, port.unit, port.access, tuple(_readers(diagram, name, port.name)))
        for port in diagram.blocks[name].outputs
        if port.name in there
    ]


def _readers(diagram: Diagram, name: str, port: str) -> Sequence[End]:
    return [end for end, source in diagram.sources.items() if source == Wire(name, port)]
