from __future__ import annotations

import re

import pytest

from dmframe.block.port import Side
from dmframe.common.names import unicode_name
from dmframe.diagram.wiring import Derived, Wire
from dmframe.drawing import mermaid
from dmframe.graph.graph import Graph


@pytest.fixture(scope="module", params=["ur10_fast", "pendulum"])
def diagram(request):
    return Graph.read(request.param).diagram


def test_each_wire_has_a_line_of_its_own(diagram):
    text = mermaid(diagram)
    ids = {name: re.search(rf"b\d+_{name}\b", text).group() for name in diagram.blocks}
    lines = [line.strip() for line in text.splitlines()]
    wires = [(end, source) for end, source in diagram.sources.items() if isinstance(source, Wire)]
    for (name, port), source in wires:
        label = " → ".join(dict.fromkeys(map(unicode_name, (source.port, port))))
        assert lines.count(f'{ids[source.block]} -- "{label}" --> {ids[name]}') == 1
    assert sum("-->" in line for line in lines) == len(wires)
    derived = [source for source in diagram.sources.values() if isinstance(source, Derived)]
    assert sum(".->" in line for line in lines) == len(derived)


def test_controller_and_plant_are_subgraphs(diagram):
    text = mermaid(diagram)
    assert text.startswith("flowchart LR\n")
    controller, plant = re.findall(r"subgraph \w+.*?\n(.*?)\n  end", text, re.DOTALL)
    for name, block in diagram.blocks.items():
        assert f"<b>{name}</b>" in (plant if block.side is Side.PLANT else controller)


def test_a_title_is_front_matter_with_quotes_escaped(diagram):
    assert mermaid(diagram, 'a "b"\nc').startswith('---\ntitle: "a #quot;b#quot; c"\n---\nflowchart LR\n')
