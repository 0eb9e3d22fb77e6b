"""Netlist of a diagram for a picture: boxes, nets, and the order of signal flow."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, final

from dmframe.block import AbstractBlock
from dmframe.block.port import Side
from dmframe.common.names import unicode_name
from dmframe.diagram.wiring import Derived, End, Source, Wire

SWEEPS = 8


@final
@dataclass(frozen=True)
class Pin:
    """Input of a block, driven by the net `source`, differentiated `order` times."""

    name: str
    source: End
    order: int = 0
    root: str = ""
    """Input of the same block whose derivative this one is."""


@final
@dataclass(frozen=True)
class Box:
    """A block."""

    name: str
    kind: str
    side: Side
    states: tuple[str, ...]
    """Printed names."""
    inputs: tuple[Pin, ...]
    outputs: tuple[str, ...]
    """Wired outputs."""


@final
@dataclass(frozen=True)
class Netlist:
    """Boxes by name, and nets: wired output -> inputs, ``(block, port) -> [(block, input), ...]``."""

    boxes: Mapping[str, Box]
    nets: Mapping[End, tuple[End, ...]]


class Stated(Protocol):
    """Object with named states."""

    @property
    def states(self) -> Iterable[str]:
        """Names of the states."""


class Wired(Protocol):
    """Blocks with their wires: a `Diagram`, or a part of one."""

    @property
    def blocks(self) -> Mapping[str, AbstractBlock]:
        """Blocks by name."""

    @property
    def sources(self) -> Mapping[End, Source]:
        """Source of each input."""

    @property
    def models(self) -> Mapping[str, Stated]:
        """States of each block."""

    def type_of(self, name: str) -> str:
        """Type of a block."""


def netlist(diagram: Wired) -> Netlist:
    """Netlist without time and unconnected inputs; derived inputs are pins of the net that they differentiate."""
    nets, inputs = dict[End, list[End]](), dict[str, list[Pin]]()
    for (name, port), source in diagram.sources.items():
        match source:
            case Wire():
                nets.setdefault((source.block, source.port), []).append((name, port))
                inputs.setdefault(name, []).append(Pin(port, (source.block, source.port)))
            case Derived():
                if (pin := _derived(diagram, name, port)) is not None:
                    inputs.setdefault(name, []).append(pin)
            case _:
                pass
    boxes = {
        name: Box(
            name=name,
            kind=diagram.type_of(name),
            side=block.side,
            states=tuple(map(unicode_name, diagram.models[name].states)),
            inputs=tuple(inputs.get(name, ())),
            outputs=tuple(port.name for port in block.outputs if (name, port.name) in nets),
        )
        for name, block in diagram.blocks.items()
    }
    return Netlist(boxes, {end: tuple(targets) for end, targets in nets.items()})


def _derived(diagram: Wired, name: str, port: str) -> Pin | None:
    """Pin of a derived input, traced through repeated derivatives to a wire."""
    order, root = 0, port
    while isinstance(source := diagram.sources[name, root], Derived):
        order, root = order + 1, source.of
    return Pin(port, (source.block, source.port), order, root) if isinstance(source, Wire) else None


def columns(net: Netlist) -> list[list[str]]:
    """Boxes in columns from left to right, controller before plant; in each column from top to bottom.

    Columns follow the longest path without feedback; the order within a column the barycentre of the neighbours.
    """
    left = [name for name, box in net.boxes.items() if box.side is not Side.PLANT]
    right = [name for name, box in net.boxes.items() if box.side is Side.PLANT]
    left.sort(key=lambda name: net.boxes[name].side is not Side.SOURCE)
    commanded = {target for end, targets in net.nets.items() if end[0] in left for target, _ in targets}
    right.sort(key=lambda name: name not in commanded)
    ranks = _ranks(net, left)
    first = 1 + max(ranks.values(), default=-1)
    ranks |= {name: first + rank for name, rank in _ranks(net, right).items()}
    made: list[list[str]] = [[] for _ in range(1 + max(ranks.values(), default=-1))]
    for name in net.boxes:
        made[ranks[name]].append(name)
    return _ordered(net, made)


def _ranks(net: Netlist, group: Sequence[str]) -> dict[str, int]:
    """Longest path within a group; then move each box as near to its targets as possible."""
    onward = {name: dict.fromkeys(t for e, ts in net.nets.items() if e[0] == name for t, _ in ts) for name in group}
    forward = {name: [t for t in onward[name] if t in onward and t != name] for name in group}
    order = _without_feedback(group, forward)
    ranks = dict.fromkeys(group, 0)
    for name in order:
        for target in forward[name]:
            ranks[target] = max(ranks[target], ranks[name] + 1)
    for name in reversed(order):
        if forward[name]:
            ranks[name] = min(ranks[target] for target in forward[name]) - 1
    return ranks


def _without_feedback(group: Sequence[str], forward: dict[str, list[str]]) -> list[str]:
    """Remove edges that close a loop, in place; return the names in topological order."""
    done, opened, finished = set[str](), list[str](), list[str]()

    def visit(name: str) -> None:
        opened.append(name)
        forward[name] = [target for target in forward[name] if target not in opened]
        for target in forward[name]:
            if target not in done:
                visit(target)
        opened.pop()
        done.add(name)
        finished.append(name)

    for name in group:
        if name not in done:
            visit(name)
    return finished[::-1]


def _ordered(net: Netlist, made: list[list[str]]) -> list[list[str]]:
    column = {name: index for index, names in enumerate(made) for name in names}
    linked: dict[str, set[str]] = {name: set() for name in column}
    for (source, _), targets in net.nets.items():
        for target, _ in targets:
            if column[source] < column[target]:
                linked[source].add(target)
                linked[target].add(source)
    for sweep in range(SWEEPS):
        place = {name: i - (len(names) - 1) / 2 for names in made for i, name in enumerate(names)}
        ahead = sweep % 2 == 0
        for index in range(len(made)) if ahead else reversed(range(len(made))):
            weight = dict[str, float]()
            for name in made[index]:
                near = [place[other] for other in linked[name] if (column[other] < index) == ahead]
                weight[name] = sum(near) / len(near) if near else place[name]
            made[index].sort(key=weight.__getitem__)
            place |= {name: i - (len(made[index]) - 1) / 2 for i, name in enumerate(made[index])}
    return made
