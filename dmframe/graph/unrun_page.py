"""The page of a graph whose block files are not run: what it is, and what nobody has checked."""

from __future__ import annotations

from typing import Final

from dmframe.block.prose import about
from dmframe.columns import columns
from dmframe.config.unrun import Unrun
from dmframe.diagram.wiring import Zero
from dmframe.errors import visible
from dmframe.formula.unmarked import unmarked
from dmframe.graph.pages import source_text
from dmframe.units import plain, shorten

UNCHECKED: Final = "equations, shapes, units and access of wires, algebraic loops, the start; they need the code"


def unrun_page(graph: Unrun) -> str:
    """Blocks with their types, states and parameters, wires by name, and what is not known or not checked."""
    experiment = graph.experiment
    file, robot = experiment.file, experiment.robot
    clock = "continuous time" if file.clock is None else f"every {plain(file.clock, 's')}"
    parts = [
        f"{experiment.name}: {visible(file.title)}".rstrip(": "),
        f"clock     {clock}, for {plain(file.duration, 's')}",
        *([f"robot     {robot.name}: {', '.join(robot.joint_names)}"] if robot is not None else []),
    ]
    heads = ("name", "type", "side", "states", "parameters")
    blocks = [
        (
            name,
            str(file.blocks[name]["type"]),
            block.side.value,
            ", ".join(graph.models[name].states) or "-",
            ", ".join(type(block).model_fields) or "-",
        )
        for name, block in graph.blocks.items()
    ]
    wires = [
        (f"{name}.{port.name}", "<-", _source(graph, name, port.name), port.unit or "-")
        for name, block in graph.blocks.items()
        for port in block.inputs
    ]
    said = [(name, shorten(visible(unmarked(about(item.kind).summary)), 100)) for name, item in graph.files.items()]
    unknown = [(name, f"not known without running it: {', '.join(names)}") for name, names in graph.unread.items()]
    looked = [*((name, text) for name, text in said if text), *unknown]
    rows = ([heads, *blocks], wires, looked)  # a file that nobody trusts may hold what a terminal obeys
    safe = (columns([tuple(map(visible, row)) for row in table]) for table in rows)
    titled = [line for title, table in zip(("blocks", "wires", "read, not run"), safe, strict=True)
              for line in ("", title, table)]  # fmt: skip
    return "\n".join([*map(visible, parts), *titled, "", f"not checked: {UNCHECKED}"])


def _source(graph: Unrun, name: str, port: str) -> str:
    source = graph.sources[name, port]
    return "not known" if isinstance(source, Zero) and graph.partly else source_text(source, name)
