"""XML as URDF readers take it: prefixes of names without a declared namespace, and the line of each element."""

from __future__ import annotations

from xml.etree import ElementTree
from xml.parsers import expat

Element = ElementTree.Element
Lines = dict[Element, int]
"""Line of the file on which each element begins."""


def parse_xml(text: str) -> tuple[Element, Lines]:
    """The tree of a text, and the line of each element, which ElementTree's own parser does not keep.

    Raises
    ------
    expat.ExpatError
        Broken XML. A prefix without a namespace, common in exports for Gazebo, is part of the name.
    """
    builder, lines = ElementTree.TreeBuilder(), Lines()
    parser = expat.ParserCreate()
    parser.buffer_text = True

    def begin(tag: str, attributes: dict[str, str]) -> None:
        lines[builder.start(tag, attributes)] = parser.CurrentLineNumber

    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda tag: builder.end(tag)
    parser.CharacterDataHandler = builder.data
    parser.Parse(text, True)
    return builder.close(), lines


def place_of(where: str, lines: Lines, element: Element) -> str:
    """File and line of an element; the file alone for one that was added or converted."""
    return f"{where}:{lines[element]}" if lines.get(element) else where
