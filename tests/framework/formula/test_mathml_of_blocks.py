"""The formulas of all blocks as MathML: those of the laws with each option, and those of their text."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from functools import cache

import pytest
from latex2mathml.converter import convert

from dmframe.block.prose import about
from dmframe.catalogue import block_types
from dmframe.formula.alone import variants
from dmframe.report.mathml import breakable, mathml

MARKED = re.compile(r"\$([^$]+)\$")


@cache
def formulas(kind):
    """Formulas of the printed laws with each option, which `formula/test_laws.py` compares with the code, and text."""
    law = about(kind)
    lines = [line for read, _ in variants(kind) for line in read.law().lines]
    found = [part for line in lines for part in (line.left.latex, f"= {line.right.latex}")]
    for text in (law.summary, law.notes, law.source, *law.parameters.values()):
        found += MARKED.findall(text)
    return list(dict.fromkeys(found))


def text_of(math):
    return "".join(ET.fromstring(f"<x>{math}</x>").itertext())


@pytest.mark.parametrize("name", block_types())
def test_every_formula_of_every_block_becomes_mathml(name):
    found = formulas(block_types()[name])
    assert found or name in ("setpoint", "waypoints")
    for latex in found:
        made = breakable(latex)
        assert "<code>" not in made
        assert "\\" not in text_of(made), latex
        assert "xmlns" not in made


LOOKS = str.maketrans(
    {"⊤": "T", "^": "ˆ", "~": "˜", "·": "⋅", "¯": "ˉ", "′": "'", "ℱ": "F", "\u2061": None, "\u00a0": None, " ": None}
)
"""Signs that differ in appearance only, and blanks."""


def signs(math):
    return "".join(text_of(math).split()).translate(LOOKS).replace("\\_", "_")


@pytest.mark.parametrize("name", block_types())
def test_a_formula_has_the_signs_of_another_converter_in_its_order(name):
    for latex in formulas(block_types()[name]):
        words = re.sub(r"(?<=_)\{([A-Za-z]{2,})\}", r"{\\text{\1}}", latex)
        assert signs(mathml(latex)) == signs(convert(re.sub(r"\\operatorname\{([^}]*)\}", r"\\text{\1}", words))), latex
