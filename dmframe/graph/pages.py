"""Text pages of graphs and block types, as the command line prints them."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from dmframe.block import AbstractBlock, type_name
from dmframe.block.parameter import PAIRS, Spec, specs
from dmframe.block.port import Access, Input, Output, Side, Signal, State
from dmframe.block.prose import about, prose
from dmframe.common.columns import columns, page_width, width
from dmframe.common.names import unicode_name
from dmframe.common.units import plain
from dmframe.config import BaseGraph
from dmframe.diagram import Diagram
from dmframe.diagram.wiring import Ahead, Derived, Drawn, Period, Source, Time, Wire
from dmframe.formula import Line
from dmframe.formula.alone import in_yaml, options_of, simplest
from dmframe.formula.docstring import check_docstring
from dmframe.formula.unmarked import unmarked
from dmframe.formula.where import sizes_show, where
from dmframe.formula.wrap import wrapped
from dmframe.simulate.warnings import unread


def check_page(graph: BaseGraph) -> str:
    """Blocks, wires, sizes, states and clock of a graph that builds."""
    diagram, loop = graph.diagram, graph.diagram.loop
    clock = "continuous time" if graph.file.clock is None else f"every {plain(graph.file.clock, 's')}"
    letters = ", ".join(f"{letter} = {size} ({by})" for letter, (size, by) in diagram.sizes.bound.items())
    blocks = (
        (name, diagram.type_of(name), block.side.value, _names(diagram.models[name].states))
        for name, block in diagram.blocks.items()
    )
    wires = (_wire(diagram, name, port) for name, block in diagram.blocks.items() for port in block.inputs)
    states = loop.state.numel()
    own = sum(variable.symbol.numel() for variable in loop.controller)
    parts = [
        f"{graph.name}: {graph.file.title}".rstrip(": "),
        f"clock     {clock}, for {plain(graph.file.duration, 's')}",
        f"sizes     {letters}",
        f"states    {states}, of which the controller's {own}",
    ]
    if diagram.robot is not None:
        parts.append(f"robot     {diagram.robot.name}: {', '.join(diagram.robot.joint_names)}")
        parts.append(f"          rotations made exact; the largest change is {diagram.robot.rotation_change:.1e}")
    heads = ("name", "type", "side", "states")
    idle = ["", *(f"notice: {text}" for text in unread(diagram))]
    page = [*parts, "", "blocks", columns([heads, *blocks]), "", "wires", columns(wires), *(idle if idle[1:] else [])]
    return "\n".join(page)


def _wire(diagram: Diagram, name: str, port: Signal) -> tuple[str, str, str, str, str]:
    shape = " x ".join(str(size) for size in diagram.sizes.of(port.shape)) or "1"
    source = diagram.sources[name, port.name]
    return f"{name}.{port.name}", "<-", source_text(source, name), shape, port.unit or "-"


def source_text(source: Source, name: str) -> str:
    """What drives an input of the block of that name."""
    match source:
        case Wire(block, port):
            return f"{block}.{port}"
        case Derived(of):
            return f"d/dt {name}.{of}"
        case Time():
            return "time"
        case Period():
            return "the sampling period"
        case Drawn():
            return "drawn again at each sample"
        case Ahead(of, samples):
            return f"{name}.{of}, {_samples(samples)} later"
        case _:
            return "0 (not driven)"


def _samples(count: int) -> str:
    return "a sample" if count == 1 else f"{count} samples"


def _names(names: Iterable[str]) -> str:
    return ", ".join(names) or "-"


def block_list(kinds: Mapping[str, type[AbstractBlock]]) -> str:
    """All block types, by side."""
    parts = []
    for side in Side:
        mine = [(name, first_line(kind)) for name, kind in kinds.items() if kind.side is side]
        parts.append(f"{side.value}\n{columns(mine)}")
    return "\n\n".join(parts)


def first_line(kind: type[AbstractBlock]) -> str:
    """Description of a block type in one line."""
    return unmarked(prose((inspect.getdoc(kind) or "").split("\n")[0]))


def block_page(kind: type[AbstractBlock]) -> str:
    """A block's law, printed from its code, its ports, states, parameters, and the text of its docstring."""
    page, wide = about(kind), page_width()
    parts = [
        f"{type_name(kind)} ({kind.side.value})",
        textwrap.fill(unmarked(page.summary), wide),
        *_laws(kind, wide),
    ]
    parts += [f"docstring\n{columns((fault.text,) for fault in faults)}"] if (faults := check_docstring(kind)) else []
    for title, ports in (("inputs", kind.inputs), ("outputs", kind.outputs)):
        parts.append(f"{title}\n{columns(_port(port) for port in ports)}")
    states = ((s.name, unicode_name(s.name), f"({s.shape})", s.unit or "-", _state_properties(s)) for s in kind.states)
    parts.append(f"states\n{columns(states)}")
    if kind.truth:
        parts.append(f"true values, which its certificate alone reads\n{columns(_port(port) for port in kind.truth)}")
    parts.append(f"parameters\n{columns(_parameters(kind))}")
    names = dict[str, list[str]]()
    for name, text in page.parameters.items():
        names.setdefault(text, []).append(name)
    lines = [f"{', '.join(several)}: {unmarked(text)}" for text, several in names.items()]
    parts += ["\n".join(textwrap.fill(text, wide, **_INDENT) for text in lines)] * bool(lines)
    parts += [textwrap.fill(unmarked(text), wide) for text in (page.notes, page.source) if text]
    return "\n\n".join(parts)


_INDENT: Final[Mapping[str, Any]] = {"initial_indent": "  ", "subsequent_indent": "    "}


def _laws(kind: type[AbstractBlock], wide: int) -> Iterable[str]:
    """The equations with default options, the changes by each option, and the meaning of their symbols."""
    found = simplest(kind)
    if found is None:
        yield "law\n  not available without parameter values: see it in a graph's report"
        return
    label, law = found
    options = dict(options_of(kind))
    shown = [*law.lines, *(line for lines in options.values() for line in lines)]
    given = f", with {label}" * bool(label) + _EXAMPLE * sizes_show(shown)
    stated = {line.name for line in law.truths}
    own = [line for line in law.lines if line not in law.truths]
    yield f"{textwrap.fill(f'law{given}', wide)}\n{_equations(own, wide)}"
    for option, lines in options.items():
        yield f"with {option}\n{_equations([line for line in lines if line.name not in stated], wide)}"
    properties = [("", list(law.truths))]
    properties += [
        (f"with {option}", [line for line in lines if line.name in stated]) for option, lines in options.items()
    ]
    stated_lines = [
        f"  {option}\n{textwrap.indent(_equations(lines, wide - 2), '  ')}" if option else _equations(lines, wide)
        for option, lines in properties
        if lines
    ]
    if stated_lines:
        yield "\n".join(["true values that it states, for the certificates of other blocks", *stated_lines])
    signs = where(shown)
    if signs:
        room = max(width(sign) for sign, _ in signs)
        yield "\n".join(["where", *(_hanging(sign, text, room, wide) for sign, text in signs)])


_EXAMPLE: Final = "; the sizes that show are those of an example, a robot of three joints with a task in a plane"


def _hanging(sign: str, text: str, room: int, wide: int) -> str:
    """A symbol with its description, wrapped with a hanging indent."""
    lines = textwrap.wrap(text, max(20, wide - room - 4))
    head = f"  {sign}{' ' * (room - width(sign))}  "
    return "\n".join([head + lines[0], *(" " * (room + 4) + line for line in lines[1:])])


def _equations(lines: Sequence[Line], wide: int) -> str:
    """Equations aligned at the equals sign; a long one continues in the next line, before a + or -."""
    room = max((width(line.left.unicode) for line in lines), default=0)
    rows = []
    for line in lines:
        left = line.left.unicode + " " * (room - width(line.left.unicode))
        first, *more = wrapped(line.right.unicode, wide - room - 5)
        rows += [f"  {left} = {first}", *(f"  {' ' * room}   {text}" for text in more)]
    return "\n".join(rows) or "  none: each output equals a state or a parameter"


def _state_properties(state: State) -> str:
    sets = [name for name in (state.box, state.ball) if name]
    sets += [f"the bodies above {state.bodies}"] * bool(state.bodies)
    properties = ["sampled"] * state.sampled + [f"projected onto {' or '.join(sets)}"] * bool(sets)
    return ", ".join(properties + ["optional"] * (state.optional and not sets))


def _port(port: Signal) -> tuple[str, ...]:
    properties = [port.access.value] if isinstance(port, Output) and port.access is not Access.INTERNAL else []
    properties += [f"derivative of {port.derivative_of}"] * bool(port.derivative_of) + ["optional"] * port.optional
    if isinstance(port, Output):
        properties += [f"replaces {port.instead_of}"] * bool(port.instead_of) + ["a notice if not 0"] * bool(
            port.notice
        )
    if isinstance(port, Input):
        properties += [f"drawn at each sample, {port.drawn}"] * bool(port.drawn)
        properties += [f"{port.ahead_of}, {_samples(port.ahead)} later"] * bool(port.ahead_of)
    return port.name, unicode_name(port.name), f"({port.shape})", port.unit or "-", ", ".join(properties)


def _parameters(kind: type[AbstractBlock]) -> Iterable[tuple[str, str, str, str]]:
    known = specs(kind)
    for name, field in kind.model_fields.items():
        default = (
            "needed"
            if field.is_required()
            else _absent(known.get(name))
            if field.default is None
            else in_yaml(field.default)
        )
        if name in known:
            spec = known[name]
            yield name, f"({spec.shape})", " ".join([spec.unit or "-", spec.sign]).strip(), default
        else:
            yield name, "", "option", default


def _absent(spec: Spec | None) -> str:
    return "no bound" if spec is not None and spec.form in PAIRS else "none"
