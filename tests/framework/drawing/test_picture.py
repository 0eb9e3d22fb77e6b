from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import pytest

from dmframe.common.names import unicode_name
from dmframe.diagram.wiring import Wire
from dmframe.drawing import svg
from dmframe.graph.graph import Graph

SVG = "{http://www.w3.org/2000/svg}"
GRAPHS = ["ur10_fast", "ur10_fast_kinematic", "pendulum", "arm2_joint"]


@pytest.fixture(scope="module", params=GRAPHS)
def diagram(request):
    return Graph.read(request.param).diagram


def texts(root, kind):
    return [written(item) for item in root.iter(f"{SVG}text") if kind in item.get("class", "").split()]


def written(item):
    """A text with its subscripts written as in a graph, x_d_1."""
    pieces = [item.text or ""]
    for span in item:
        word = span.text.strip("\u200b").replace(",", "_")
        pieces += [f"_{word}" if span.get("class") == "sub" else word, span.tail or ""]
    return "".join(pieces)


def test_the_picture_is_well_formed_and_self_contained(diagram):
    text = svg(diagram, "a title")
    root = ET.fromstring(text)
    assert root.tag == f"{SVG}svg"
    assert texts(root, "title") == ["a title"]
    assert "href" not in text
    assert "url(" not in text


def test_each_block_is_listed_with_its_type_and_states(diagram):
    root = ET.fromstring(svg(diagram))
    blocks = {item.get("data-name"): item for item in root.iter(f"{SVG}g") if item.get("class") == "block"}
    assert set(blocks) == set(diagram.blocks)
    for name, item in blocks.items():
        assert texts(item, "name") == [name]
        assert texts(item, "kind") == [diagram.type_of(name)]
        shown = " ".join(texts(item, "states")).removeprefix("states:").replace(",", " ").split()
        assert shown == [unicode_name(state) for state in diagram.models[name].states]


def test_each_wire_is_labelled_and_states_from_where_to_where(diagram):
    root = ET.fromstring(svg(diagram))
    labels = set(texts(root, "label"))
    titles = [item.find(f"{SVG}title").text for item in root.iter(f"{SVG}g") if item.get("class") == "net"]
    for (name, port), source in diagram.sources.items():
        if isinstance(source, Wire):
            assert unicode_name(source.port) in labels
            (line,) = [text for text in titles if text.startswith(f"{source.block}.{source.port} -> ")]
            assert f"{name}.{port}" in line


def test_indices_are_subscripts_and_the_line_goes_on_after_them(diagram):
    root = ET.fromstring(svg(diagram))
    symbols = [item for kind in ("pin", "label", "states") for item in of(root, kind)]
    assert any(span.get("class") == "sub" for item in symbols for span in item)
    for item in symbols:
        plain = "".join(part for part in (item.text, *(span.tail for span in item)) if part)
        assert not re.search(r"(^|\s)[^\W\d_]{1,2}_", plain)
        assert sum(float(span.get("dy")) for span in item) == 0


def of(root, kind):
    return [item for item in root.iter(f"{SVG}text") if kind in item.get("class", "").split()]


def test_derived_inputs_are_marked_and_the_wall_is_named(diagram):
    root = ET.fromstring(svg(diagram))
    assert texts(root, "small").count("d/dt") == len(texts(root, "small")) > 0
    (wall,) = [item for item in root.iter(f"{SVG}line") if item.get("class") == "wall"]
    (closed,) = [item for item in root.iter(f"{SVG}text") if item.text == "closed architecture"]
    assert closed.get("text-anchor") is None  # it begins right of the boundary, on the robot's side
    assert float(closed.get("x")) > float(wall.get("x1"))


def test_letters_of_a_title_that_xml_reserves_are_escaped(diagram):
    assert texts(ET.fromstring(svg(diagram, 'a < b & "c"')), "title") == ['a < b & "c"']


def test_everything_lies_within_the_picture(diagram):
    root = ET.fromstring(svg(diagram))
    width, height = float(root.get("width")), float(root.get("height"))
    (group,) = [item for item in root if item.tag == f"{SVG}g"]
    shift = float(group.get("transform").split()[1].rstrip(")"))
    for rect in group.iter(f"{SVG}rect"):
        assert float(rect.get("x")) >= 0
        assert float(rect.get("x")) + float(rect.get("width")) <= width
        assert float(rect.get("y")) + shift >= 0
        assert float(rect.get("y")) + float(rect.get("height")) + shift <= height


def test_the_same_diagram_gives_the_same_picture(diagram):
    assert svg(diagram) == svg(diagram)
