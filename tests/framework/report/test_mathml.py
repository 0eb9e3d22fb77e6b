from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import pytest

from dmframe.block.prose import about
from dmframe.catalogue import block_types
from dmframe.formula.alone import options_of, plainest
from dmframe.report.mathml import breakable, mathml, terms

MARKED = re.compile(r"\$([^$]+)\$")


def formulas(kind):
    law, found = about(kind), plainest(kind)
    options = (line for _, lines in options_of(kind) for line in lines)
    for line in (*(found[1].lines if found else ()), *options):
        yield from (line.left.latex, f"= {line.right.latex}")
    for text in (law.summary, law.notes, law.source, *law.parameters.values()):
        yield from MARKED.findall(text)


def text_of(math):
    return "".join(ET.fromstring(f"<x>{math}</x>").itertext())


@pytest.mark.parametrize("name", block_types())
def test_every_formula_of_every_block_becomes_mathml(name):
    found = list(formulas(block_types()[name]))
    assert found or name in ("setpoint", "waypoints")
    for latex in found:
        made = breakable(latex)
        assert "<code>" not in made
        assert "\\" not in text_of(made), latex
        assert "xmlns" not in made


def test_a_formula_is_cut_before_the_signs_between_its_terms_alone():
    assert terms(r"= -a (b + c) - \tfrac{d + e}{2} + |f - g|^2 \quad h") == [
        "= -a (b + c)",
        r"- \tfrac{d + e}{2}",
        r"+ |f - g|^2 \quad",
        "h",
    ]


def test_a_long_term_is_cut_inside_its_brackets_too():
    latex = r"p_{x2} s_{23} (" + " + ".join(rf"\dot q_{{{i}}} \dot q_{{\mathrm r{i}}}" for i in range(8)) + ")"
    assert len(terms(latex)) == 8
    assert "".join(terms(latex)).replace(" ", "") == latex.replace(" ", "")


def test_the_pieces_of_a_formula_hold_all_that_it_says():
    latex = r"S = \tfrac12 |e|^2_{K K_I} - \dot{\hat a}_d \ge \sum_i w_i"
    assert text_of(breakable(latex)) == text_of(mathml(latex))


def test_a_sign_between_two_pieces_is_no_sign_of_its_own():
    assert 'form="infix"' in breakable("a - b").split("<wbr/>")[1]
    assert 'form="infix"' not in mathml("-a")


def test_bars_are_fences_and_words_in_indices_stand_upright():
    made = mathml(r"|q_{ref}|^2")
    assert 'fence="true" form="prefix"' in made
    assert "<mtext>ref</mtext>" in made


@pytest.mark.parametrize(("latex", "sign"), [(r"\dot q", "\u02d9"), (r"\hat a", "\u02c6"), (r"\tilde a", "\u02dc")])
def test_accents_are_accents(latex, sign):
    mover = ET.fromstring(mathml(latex)).find(".//mover")
    assert mover.get("accent") == "true"
    assert mover[1].text == sign


def test_latex_that_cannot_be_read_stays_as_it_was_typed():
    assert mathml(r"\left( a < b") == r"<code>\left( a &lt; b</code>"


def test_the_name_of_a_function_is_one_word_whatever_it_is_made_of():
    assert "<mtext>of_joint</mtext>" in mathml(r"\operatorname{of\_joint}(x) h")
