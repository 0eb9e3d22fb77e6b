from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import pytest

from dmframe.report.mathml import breakable, mathml, terms


def text_of(math):
    return "".join(ET.fromstring(f"<x>{math}</x>").itertext())


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


def test_the_pieces_of_a_formula_hold_all_that_it_states():
    latex = r"S = \tfrac12 |e|^2_{K K_I} - \dot{\hat a}_d \ge \sum_i w_i"
    assert text_of(breakable(latex)) == text_of(mathml(latex))


def test_a_sign_between_two_pieces_is_no_sign_of_its_own():
    assert 'form="infix"' in breakable("a - b").split("<wbr/>")[1]
    assert 'form="infix"' not in mathml("-a")


def test_bars_are_fences_and_words_in_indices_are_upright():
    made = mathml(r"|q_{ref}|^2")
    assert made.count('<mo fence="true" form="prefix" stretchy="true">|</mo>') == 1
    assert "<mtext>ref</mtext>" in made
    assert mathml("p(a | b)").count("<mo>|</mo>") == 1


@pytest.mark.parametrize(
    ("latex", "made"),
    [
        (r"\tfrac12 x_1^2", "mstyle(mfrac(1 2)) msubsup(x 1 2)"),
        (r"\sum_{i=1}^n \hat{a}_i", "munderover(∑ (i = 1) n) msub(mover(a ˆ) i)"),
        (r"\sqrt{2} \left[ q \right]", "msqrt(2) ([ (q) ])"),
        (r"\begin{cases} a & b > 0 \\ -a & \text{else} \end{cases}", "({ mtable(mtr((a) (b > 0)) mtr((− a) (else))))"),
        (r"\underbrace{a + b}_{c}", "munder(munder((a + b) ⏟) c)"),
        (r"\mathbb R^{n}, f'", "msup(ℝ n) , msup(f ′)"),
    ],
)
def test_the_structure_of_a_formula(latex, made):
    def shown(element):
        inside = " ".join(map(shown, element)) or element.text or ""
        named = element.tag not in ("mrow", "mi", "mn", "mo", "mtd", "mtext")
        return f"{element.tag}({inside})" if named else f"({inside})" if element.tag == "mrow" else inside

    assert shown(ET.fromstring(mathml(latex)))[6:-2] == made


def test_signs_and_functions_have_the_space_of_their_place():
    made = mathml(r"-a = -b - c \sin q")
    assert re.findall(r'<mo form="(\w+)">−', made) == ["prefix", "prefix", "infix"]
    assert made.count("<mspace") == 2
    assert "<mspace" not in mathml(r"(\sin(q))")


@pytest.mark.parametrize(("latex", "sign"), [(r"\dot q", "\u02d9"), (r"\hat a", "\u02c6"), (r"\tilde a", "\u02dc")])
def test_accents_are_accents(latex, sign):
    mover = ET.fromstring(mathml(latex)).find(".//mover")
    assert mover.get("accent") == "true"
    assert mover[1].text == sign


@pytest.mark.parametrize(
    "latex", [r"\left( a < b", r"\nosuch{x}", "a}", "{a", "a^2^3", r"\mathrm{\tau}", r"\begin{x}\end{x}"]
)
def test_latex_that_is_not_supported_stays_as_it_was_typed(latex):
    assert mathml(latex) == f"<code>{latex.replace('<', '&lt;')}</code>"


def test_the_name_of_a_function_is_one_word_whatever_it_is_made_of():
    assert "<mi>of_joint</mi>" in mathml(r"\operatorname{of\_joint}(x) h")
