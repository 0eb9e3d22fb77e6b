"""Wiring: connect each input to an output by name or by the graph file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, replace
from typing import final

from dmframe.block import AbstractBlock
from dmframe.block.port import ANY, PERIOD, TIME, Access, Input, Output, Side
from dmframe.common.errors import (
    AccessError,
    DmframeError,
    UnknownNameError,
    WiringError,
    nearest,
)
from dmframe.common.units import is_rate

End = tuple[str, str]
"""A block's name and a port's."""


@final
@dataclass(frozen=True)
class Wire:
    """The input is connected to this output."""

    block: str
    port: str


@final
@dataclass(frozen=True)
class Derived:
    """The input is the time derivative of another input of its block."""

    of: str


@final
@dataclass(frozen=True)
class Time:
    """The input is the time t."""


@final
@dataclass(frozen=True)
class Period:
    """The input is the sampling period T."""


@final
@dataclass(frozen=True)
class Drawn:
    """The input is random, drawn at each sample."""


@final
@dataclass(frozen=True)
class Ahead:
    """The input is another input of its block, whole samples later."""

    of: str
    samples: int


@final
@dataclass(frozen=True)
class Zero:
    """The optional input is not driven: zero."""


ADD = "add a block that has one"
"""Last remedy of a missing signal; `dmframe.config.places` names the block types."""
Source = Wire | Derived | Time | Period | Drawn | Ahead | Zero
Outputs = Mapping[str, Mapping[str, Output]]


def wire_blocks(
    blocks: Mapping[str, AbstractBlock], outputs: Outputs, wires: Mapping[str, str]
) -> tuple[dict[End, Source], list[DmframeError]]:
    """A source for every input; the wires of the graph file have precedence over names."""
    chosen, faults = _explicit(blocks, outputs, wires)
    sources = dict[End, Source]()
    for name, block in blocks.items():
        for port in block.inputs:
            end = (name, port.name)
            if end in chosen:
                sources[end] = chosen[end]
                continue
            optional = not block.requires(port, name)
            commanded = _as_the_plant(block, port, blocks, chosen)
            found = commanded or _by_name(name, port, outputs, blocks, optional=optional)
            if isinstance(found, DmframeError):
                faults.append(found)
            else:
                sources[end] = found
    _lead_through(blocks, outputs, sources)
    return sources, [*faults, *_unforeseen(blocks, outputs, sources), *_bypassed(blocks, outputs, sources)]


def _as_the_plant(
    block: AbstractBlock, port: Input, blocks: Mapping[str, AbstractBlock], chosen: Mapping[End, Source]
) -> Source | None:
    """For an input that a channel model replaces: the command that the graph file wires to the plant's input."""
    if all(output.instead_of != port.name for output in block.outputs):
        return None
    commands = {
        source
        for (reader, name), source in chosen.items()
        if name == port.name
        and blocks[reader].side is Side.PLANT
        and isinstance(source, Wire)
        and blocks[source.block].side is Side.CONTROLLER
    }
    return commands.pop() if len(commands) == 1 else None


def _unforeseen(
    blocks: Mapping[str, AbstractBlock], outputs: Outputs, sources: Mapping[End, Source]
) -> Iterator[WiringError]:
    """Faults of inputs that look ahead at a signal whose future is unknown."""
    for (name, port), source in sources.items():
        if not isinstance(source, Ahead):
            continue
        now = sources.get((name, source.of))
        if now is None:
            continue
        if isinstance(now, Wire) and blocks[now.block].side is Side.SOURCE:
            clock = sources.get((now.block, TIME.name))
            if isinstance(clock, Wire) and f"{clock.port}_{source.samples}" not in outputs.get(clock.block, {}):
                yield WiringError(
                    f"{name}.{port}: expected {clock.block}, which provides the time of {now.block}, to have an output "
                    f"{clock.port}_{source.samples}, the future {clock.port}, found none; see path_pace",
                    path=("wires", f"{now.block}.{TIME.name}"),
                )
            continue
        found = f"{now.block}.{now.port}" if isinstance(now, Wire) else "no other block's"
        samples = "a sample" if source.samples == 1 else f"{source.samples} samples"
        yield WiringError(
            f"{name}.{port}: expected {name}.{source.of}, which it is {samples} later, to be the signal of a source, "
            f"found {found}; only the future of a function of time is known",
            path=("blocks", name),
        )


def _bypassed(
    blocks: Mapping[str, AbstractBlock], outputs: Outputs, sources: Mapping[End, Source]
) -> Iterator[WiringError]:
    """Faults of channel models of a command that the plant does not read, so that they would have no effect."""
    for way in ways(blocks, outputs, sources):
        last = way.through[-1]
        replaced = outputs[last.block][last.port].instead_of
        commands = {
            f"{source.block}.{source.port}"
            for (reader, port), source in sources.items()
            if port == replaced and isinstance(source, Wire) and blocks[reader].side is Side.PLANT
            if blocks[source.block].side is Side.CONTROLLER and source != way.origin
        }
        if commands and not any(blocks[reader].side is Side.PLANT for reader, _ in way.readers):
            first = way.through[0].block
            yield WiringError(
                f"{first}.{replaced}: expected a command that the plant reads, found {way.origin.block}."
                f"{way.origin.port}, which it does not read, so that {first} would have no effect; write under wires "
                f"{first}.{replaced}: {min(commands)}",
                path=("wires", f"{first}.{replaced}"),
            )


@final
@dataclass(frozen=True)
class Way:
    """Path of a signal from one side to the other: the channel models on it, and the readers."""

    origin: Wire
    through: tuple[Wire, ...]
    readers: tuple[End, ...]


def ways(blocks: Mapping[str, AbstractBlock], outputs: Outputs, sources: Mapping[End, Source]) -> list[Way]:
    """Each signal that channel models replace (`Output.instead_of`), as wired."""
    stands = _channel_models(blocks, outputs, sources)
    found = list[Way]()
    for origin, chain in stands.items():
        members = {wire.block for wire, _ in chain}
        readers = [end for end, source in sources.items() if source == chain[-1][0] and end[0] not in members]
        found.append(Way(origin, tuple(wire for wire, _ in chain), tuple(readers)))
    return found


def _channel_models(
    blocks: Mapping[str, AbstractBlock], outputs: Outputs, sources: Mapping[End, Source]
) -> dict[Wire, list[tuple[Wire, End]]]:
    """The channel models of each signal in the order of the file, each with the input that it replaces."""
    roots, found = dict[Wire, Wire](), dict[Wire, list[tuple[Wire, End]]]()
    for name in blocks:
        for port in outputs.get(name, {}).values():
            source = sources.get((name, port.instead_of)) if port.instead_of else None
            if isinstance(source, Wire) and source.block != name:
                wire = Wire(name, port.name)
                roots[wire] = roots.get(source, source)
                found.setdefault(roots[wire], []).append((wire, (name, port.instead_of)))
    return found


def _lead_through(blocks: Mapping[str, AbstractBlock], outputs: Outputs, sources: dict[End, Source]) -> None:
    """Route the signals through their channel models, in the order of the file."""
    for origin, chain in _channel_models(blocks, outputs, sources).items():
        inside = {end for _, end in chain}
        for (_, end), (before, _) in zip(chain[1:], chain, strict=False):
            sources[end] = before
        last = chain[-1][0]
        measured = outputs[last.block][last.port].access is Access.MEASURED
        for end, source in sources.items():
            for_plant = blocks[end[0]].side is Side.PLANT
            if source == origin and end not in inside and for_plant is not measured:
                sources[end] = last


def _explicit(
    blocks: Mapping[str, AbstractBlock], outputs: Outputs, wires: Mapping[str, str]
) -> tuple[dict[End, Source], list[DmframeError]]:
    chosen, faults = dict[End, Source](), list[DmframeError]()
    inputs = {f"{name}.{port.name}": (name, port.name) for name, block in blocks.items() for port in block.inputs}
    drives = {f"{name}.{port}": Wire(name, port) for name, ports in outputs.items() for port in ports}
    for target, origin in wires.items():
        path = ("wires", target)
        if target not in inputs:
            faults.append(UnknownNameError(f"wires.{target}", "input", target, inputs, path=path))
        elif origin not in drives:
            faults.append(UnknownNameError(f"wires.{target}: {origin}", "output", origin, drives, path=path))
        else:
            chosen[inputs[target]] = drives[origin]
    return chosen, faults


def _by_name(
    name: str, port: Input, outputs: Outputs, blocks: Mapping[str, AbstractBlock], *, optional: bool
) -> Source | DmframeError:
    if replace(port, optional=False) == TIME:
        return Time()
    if port == PERIOD:
        return Period()
    if port.drawn:
        return Drawn()
    if port.ahead_of:
        return Ahead(port.ahead_of, port.ahead)
    found = [Wire(other, port.name) for other, ports in outputs.items() if other != name and port.name in ports]
    if len(found) == 1:
        return found[0]
    end = f"{name}.{port.name}"
    if found:
        ends = ", ".join(f"{wire.block}.{wire.port}" for wire in found)
        return WiringError(
            f"{end}: expected one output of that name, found {len(found)}: {ends}; "
            f"choose one under wires, for example {end}: {found[0].block}.{found[0].port}",
            path=("blocks", name),
        )
    if port.derivative_of:
        return Derived(port.derivative_of)
    if optional:
        return Zero()
    return WiringError(
        f"{end}: expected an output of that name in another block, found none; {_remedy(name, port, outputs, blocks)}",
        missing=port.name,
        path=("blocks", name),
    )


def _remedy(name: str, port: Input, outputs: Outputs, blocks: Mapping[str, AbstractBlock]) -> str:
    """Hint: a declaration as a rate, and outputs that may be wired: of the input's shape and unit and not hidden.

    A desired value is not wired to a measured or computed one: its error would be zero, or without a meaning.
    """
    sources = [other for other, block in blocks.items() if block.side is Side.SOURCE and other in outputs]
    add, target = ADD, blocks[name].side
    if of := _rate_of(port, blocks[name], {key for other in sources for key in outputs[other]}):
        add = f'declare it with derivative_of="{of}" if it is the rate of {of}, or {add}'
    desired = port.name.endswith("_d")
    fitting = [
        f"{other}.{key}"
        for other, ports in outputs.items()
        for key, out in ports.items()
        if other != name
        and (not desired or other in sources or key.endswith("_d"))
        and (out.shape, out.unit) == (port.shape, port.unit)
        and access_fault(Wire(other, key), out, blocks[other].side, (name, port.name), target, ()) is None
    ]
    if not fitting:
        return add
    return f"wire one of its shape and unit ({nearest(port.name, fitting)}), or {add}"


def _rate_of(port: Input, block: AbstractBlock, desired: Set[str]) -> str:
    """The input with a desired signal whose rate this one is by its name, shape and unit; empty if there is none."""
    found = [other for other in block.inputs if (port.name, port.shape) == (f"d{other.name}", other.shape)]
    with_units = [other for other in found if other.name in desired and ANY not in (port.unit, other.unit)]
    return next((other.name for other in with_units if is_rate(port.unit, other.unit)), "")


def unread(blocks: Mapping[str, AbstractBlock], outputs: Outputs, sources: Mapping[End, Source]) -> list[Wire]:
    """Outputs without effect: all unused outputs of a block without other effect, or an unused output of a source.

    Blocks whose outputs are shown or reported are not included, nor parts of the plant that move by themselves.
    """
    taken = {source for source in sources.values() if isinstance(source, Wire)}
    found = list[Wire]()
    for name, block in blocks.items():
        moves = block.side is Side.PLANT and block.states
        if moves or any(port.shown or port.notice for port in block.outputs):
            continue
        free = [wire for wire in (Wire(name, port) for port in outputs[name]) if wire not in taken]
        if block.side is Side.SOURCE or len(free) == len(outputs[name]):
            found += free
    return found


def access_fault(
    source: Wire, out: Output, origin: Side, end: End, target: Side, path: tuple[str, ...]
) -> DmframeError | None:
    """The fault of a wire that may not exist, since the robot's architecture is closed; None if it may."""
    reader, signal = f"{end[0]}.{end[1]}", f"{source.block}.{source.port}"
    if target is not Side.PLANT and origin is Side.PLANT and out.access is not Access.MEASURED:
        return AccessError(
            f"{signal} is hidden: {reader} cannot read it (the robot's architecture is closed)", path=path
        )
    if target is Side.PLANT and origin is Side.CONTROLLER and out.access is not Access.COMMANDED:
        return AccessError(
            f"{signal} cannot be commanded: {reader} takes only joint velocities and positions "
            "that are declared as commands (the robot's architecture is closed); if it is one, declare the output of "
            f"{source.block} with access=Access.COMMANDED",
            path=path,
        )
    if target is Side.SOURCE and origin is not Side.CONTROLLER:
        return AccessError(f"{reader} is an input of a source, whose time is t or a controller's output", path=path)
    return None
