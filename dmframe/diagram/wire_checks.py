"""Checks of wires: access, shape and unit of what an output gives to an input."""

from __future__ import annotations

from collections.abc import Mapping

from dmframe.block import AbstractBlock, type_name
from dmframe.block.port import ANY, Input, Output, Side
from dmframe.block.sizes import Sizes
from dmframe.common.errors import DmframeError, ShapeError, UnitError
from dmframe.common.units import compatible
from dmframe.diagram.wiring import End, Outputs, Source, Wire, access_fault


def check_wires(
    blocks: Mapping[str, AbstractBlock],
    outputs: Outputs,
    sources: Mapping[End, Source],
    sizes: Sizes,
    wires: Mapping[str, str],
) -> list[DmframeError]:
    """Access, shape and unit of every wire."""
    faults = list[DmframeError | None]()
    ports = {(name, port.name): port for name, block in blocks.items() for port in block.inputs}
    for (name, port), source in sources.items():
        if isinstance(source, Wire):
            out, into = outputs[source.block][source.port], ports[name, port]
            text = f"wire {source.block}.{source.port} -> {name}.{port}"
            path = ("wires", f"{name}.{port}") if f"{name}.{port}" in wires else ("blocks", name)
            barred = access_fault(source, out, blocks[source.block].side, (name, port), blocks[name].side, path)
            if barred is not None:
                faults.append(barred)
                continue
            faults.append(_shape(text, out, into, sizes, path))
            if not same_unit(out, into):
                found = out.unit or "a plain number"
                faults.append(UnitError(f"{text}: expected {into.unit or 'a plain number'}, found {found}", path=path))
    return [fault for fault in faults if fault is not None]


def check_truths(blocks: Mapping[str, AbstractBlock], outputs: Outputs) -> list[DmframeError]:
    """Check the units of the plant signals that a block's proof reads: another unit belongs to another plant."""
    plant = [
        (name, port) for name, ports in outputs.items() if blocks[name].side is Side.PLANT for port in ports.values()
    ]
    faults = list[DmframeError]()
    for name, block in blocks.items():
        incompatible = set[str]()
        for truth in block.truth:
            found = [(other, port) for other, port in plant if port.name == truth.name and other != name]
            if not found or any(same_unit(port, truth) for _, port in found):
                continue
            other, port = found[0]
            if other not in incompatible:  # one fault per block is sufficient
                incompatible.add(other)
                faults.append(
                    UnitError(
                        f"{name}: {type_name(type(block))} expects {other}.{port.name} in {truth.unit or 'no unit'}, "
                        f"found {port.unit or 'no unit'}; "
                        f"it is incompatible with {other} ({type_name(type(blocks[other]))})",
                        path=("blocks", name),
                    )
                )
    return faults


def same_unit(output: Output, reader: Input) -> bool:
    """True if the reader can use the output's numbers without conversion."""
    return reader.unit == ANY or compatible(output.unit, reader.unit)


def _shape(text: str, out: Output, into: Input, sizes: Sizes, path: tuple[str, ...]) -> DmframeError | None:
    try:
        found, expected = sizes.of(out.shape), sizes.of(into.shape)
    except KeyError:
        return None
    if found == expected:
        return None
    return ShapeError(f"{text}: expected shape {sizes.explain(into.shape)}, found {found}", path=path)
