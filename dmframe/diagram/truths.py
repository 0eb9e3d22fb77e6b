"""Find the block whose true value a proof reads: one owner per name, the nearest along wires if there are several.

Initial values and certificates of a block may read true values by name: outputs of other blocks, and values from other
blocks' certificates. ``truth.K`` means that of the robot which the block drives, not of any robot in the diagram. The
owner is the only block with the value; of several blocks it is the one with the shortest path of wires from the reader.
Paths through sources do not count, since one clock or path may drive otherwise separate loops. A value that the nearest
plant itself reads under that name has precedence: of two loads, the one that the robot carries.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterable, Iterator, Mapping
from itertools import combinations

from dmframe.block.certificate import SX
from dmframe.block.port import Input, Output, Side
from dmframe.block.steady import same_expression
from dmframe.common.errors import BlockError
from dmframe.diagram.diagram import Diagram
from dmframe.diagram.wire_checks import same_unit
from dmframe.diagram.wiring import Wire

Stated = Mapping[str, Mapping[str, SX]]
"""True values from certificates, by block and by name."""


def owner_of(diagram: Diagram, reader: str, port: Input, stated: Stated) -> str | None:
    """The block whose value of that name `reader` gets; None if the diagram has none.

    A signal of the plant has precedence over all others, since it is the true one.

    Raises
    ------
    BlockError
        Several blocks have it, and the wires do not determine one.
    """
    having = _having(diagram, reader, port)
    plant = [name for name in having if diagram.blocks[name].side is Side.PLANT]
    found = plant or list(dict.fromkeys([*having, *_stating(stated, reader, port.name)]))
    if len(found) < 2:
        return found[0] if found else None
    ways = distances(diagram, reader)
    found = [name for name in _read_by_plant(diagram, port.name, ways) if name in found] or found
    least = min((ways[name] for name in found if name in ways), default=None)
    near = [name for name in found if ways.get(name) == least]
    values = [value_of(diagram, name, port.name, stated) for name in near]
    if len(near) > 1 and not all(same_expression(values[0], other) for other in values[1:]):
        choices = ", ".join(f"{name}.{port.name}" for name in near)
        raise BlockError(
            f"{reader}: its proof needs the true {port.name}, and its wires are equally close to {choices}; "
            "expected one block that has it; rename the signals of the others, or change their wires"
        )
    return near[0]


def value_of(diagram: Diagram, owner: str, name: str, stated: Stated) -> SX:
    """A block's true value: its output of that name, or the value from its certificate."""
    if name in diagram.models[owner].equations.outputs:
        if diagram.resolver.side(owner) is Side.SOURCE:
            return diagram.resolver.trajectory(owner, name, 0).symbol
        return diagram.resolver.output(owner, name)
    return stated[owner][name]


def _read_by_plant(diagram: Diagram, name: str, ways: Mapping[str, int]) -> list[str]:
    """Blocks whose output drives the input of that name in the nearest blocks of the plant."""
    reading = {
        block: source.block
        for (block, port), source in diagram.sources.items()
        if port == name and isinstance(source, Wire) and block in ways and diagram.blocks[block].side is Side.PLANT
    }
    least = min((ways[block] for block in reading), default=0)
    return [source for block, source in reading.items() if ways[block] == least]


def distances(diagram: Diagram, start: str) -> dict[str, int]:
    """Distance of each block in wires, in either direction, without paths through sources."""
    neighbours = defaultdict[str, set[str]](set)
    for (block, _), source in diagram.sources.items():
        if isinstance(source, Wire) and diagram.blocks[source.block].side is not Side.SOURCE:
            neighbours[block].add(source.block)
            neighbours[source.block].add(block)
    found, waiting = {start: 0}, deque([start])
    while waiting:
        here = waiting.popleft()
        for other in sorted(neighbours[here] - found.keys()):
            found[other] = found[here] + 1
            waiting.append(other)
    return found


def conflicts(diagram: Diagram, stated: Stated) -> Iterator[str]:
    """Faults of the true values in certificates: each must have one owner.

    A name may not be that of another block's output. Two blocks of one loop may state the same name only with the same
    value; blocks that no wire connects belong to different robots.
    """
    for owner, values in stated.items():
        for name in values:
            for other in (other for other in diagram.blocks if other != owner):
                if name in diagram.models[other].equations.outputs:
                    yield (
                        f"the true {name} has two owners: the certificate of {owner} states it, and {other} has an "
                        f"output {other}.{name}; expected one, so give the stated one another name"
                    )
    for name in sorted({name for values in stated.values() for name in values}):
        for one, other in combinations([owner for owner in stated if name in stated[owner]], 2):
            together = other in distances(diagram, one)
            if together and not same_expression(stated[one][name], stated[other][name]):
                yield (
                    f"the true {name} has two owners: the certificates of {one} and {other} state different values, "
                    "and wires connect them; expected one, so give one of the two another name"
                )


def _having(diagram: Diagram, reader: str, port: Input) -> list[str]:
    """Blocks other than the reader with an output of that name in a compatible unit."""
    return [
        name
        for name, model in diagram.models.items()
        if name != reader and _fits(port, model.block.outputs) and port.name in model.equations.outputs
    ]


def _fits(port: Input, outputs: Iterable[Output]) -> bool:
    return any(other.name == port.name and same_unit(other, port) for other in outputs)


def _stating(stated: Stated, reader: str, name: str) -> list[str]:
    return [owner for owner, values in stated.items() if owner != reader and name in values]
