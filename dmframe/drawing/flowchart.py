"""A diagram as Mermaid text, for pages that render it."""

from __future__ import annotations

import re

from dmframe.block.port import Side
from dmframe.common.names import unicode_name
from dmframe.drawing.netlist import Box, Wired, netlist


def mermaid(diagram: Wired, title: str = "") -> str:
    """Flowchart from left to right, with controller and plant as subgraphs, and an edge for each wire.

    A wire has the label ``signal``, or ``output -> input`` if their names differ. An input that is the derivative of
    another one is a dotted edge from a box to itself.
    """
    net = netlist(diagram)
    ids = {name: f"b{index}_{re.sub(r'[^A-Za-z0-9_]', '_', name)}" for index, name in enumerate(net.boxes)}
    lines = ["---", f'title: "{_plain(title)}"', "---"] if title else []
    lines.append("flowchart LR")
    for heading, sides in (("controller", (Side.SOURCE, Side.CONTROLLER)), ("plant", (Side.PLANT,))):
        boxes = [box for box in net.boxes.values() if box.side in sides]
        if boxes:
            lines.append(f'  subgraph {heading}["{heading}"]')
            lines += [f"    {ids[box.name]}{_shape(box)}" for box in boxes]
            lines.append("  end")
    for (source, port), targets in net.nets.items():
        for target, pin in targets:
            label = unicode_name(port) if port == pin else f"{unicode_name(port)} → {unicode_name(pin)}"
            lines.append(f'  {ids[source]} -- "{_plain(label)}" --> {ids[target]}')
    for box in net.boxes.values():
        for derived in box.inputs:
            if derived.order:
                power = "" if derived.order == 1 else f"^{derived.order}"
                label = f"{unicode_name(derived.name)} = d{power} {unicode_name(derived.root)}/dt{power}"
                lines.append(f'  {ids[box.name]} -. "{_plain(label)}" .-> {ids[box.name]}')
    return "\n".join(lines) + "\n"


def _shape(box: Box) -> str:
    states = f"<br/>states: {', '.join(box.states)}" if box.states else ""
    text = f"<b>{_plain(box.name)}</b><br/><i>{_plain(box.kind)}</i>{_plain(states, keep=True)}"
    return f'(["{text}"])' if box.side is Side.SOURCE else f'["{text}"]'


def _plain(text: str, *, keep: bool = False) -> str:
    """Text escaped for Mermaid's quotes."""
    text = text.replace('"', "#quot;").replace("\n", " ")
    return text if keep else text.replace("<", "#lt;").replace(">", "#gt;")
