"""A sentence contains its formulas for each rendering; its plain `str` is the content of JSON."""

from __future__ import annotations

import copy
import json
import pickle

import pytest

from dmframe.common.text import (
    DV,
    Label,
    Text,
    Written,
    around,
    joined,
    listed_text,
    name_of,
    sentence,
    square_of,
    text_of,
)
from dmframe.formula import Formula, laws_of
from dmframe.formula.tree import Name, Norm, Rate
from dmframe.graph.graph import Graph

ERROR = Text(Written("q - q_d", "q − q_d", "q - q_{d}"))


@pytest.mark.parametrize(
    ("text", "plain", "unicode", "marked"),
    [
        (
            sentence("weight of {a} in {dV/dt} >= 0", a=square_of(ERROR)),
            "weight of |q - q_d|^2 in dV/dt >= 0",
            "weight of |q − q_d|² in V̇ ≥ 0",
            r"weight of $|q - q_{d}|^2$ in $\dot V$ ≥ 0",
        ),
        (
            Text(Label("inverse.w_I"), ": starts inside the box"),
            "inverse.w_I: starts inside the box",
            "inverse.w_I: starts inside the box",
            "`inverse.w_I`: starts inside the box",
        ),
        (
            sentence("{G} of {a}, {V(0)} < {kappa}", a=square_of(ERROR, "G")),
            "G of |q - q_d|_G^2, V(0) < kappa",
            "G of |q − q_d|²_G, V(0) < κ",
            r"$G$ of $|q - q_{d}|^2_G$, $V(0)$ < $\kappa$",
        ),
        (
            listed_text([ERROR, name_of("w"), Label("a.b")]),
            "q - q_d, w and a.b",
            "q − q_d, w and a.b",
            "$q - q_{d}$, $w$ and `a.b`",
        ),
        (joined([]), "", "", ""),
        (text_of("a signal, 50% of w_box <= 1"),) * 2 + ("a signal, 50% of w_box ≤ 1",) * 2,
    ],
)
def test_a_sentence_reads_alike_for_json_a_terminal_and_a_page(text, plain, unicode, marked):
    assert text == plain
    assert text.unicode == unicode
    assert text.marked == marked


def test_as_one_formula_words_are_set_as_text():
    assert Text(ERROR, " (task_1)").latex == r"q - q_{d}\text{ (task\_1)}"
    assert around(ERROR, "d({})/dt", r"\tfrac{d}{dt} ({})").latex == r"\tfrac{d}{dt} (q - q_{d})"


def test_signs_that_are_written_by_hand_are_those_of_a_formula():
    x = Name("x", (2, 1))
    for mine, formula in (
        (DV, Formula(Rate(Name("V"), (1, 1)))),
        (name_of("K_star"), Formula(Name("K_star"))),
        (square_of(Text(name_of("x"))), Formula(Norm(x, squared=True))),
    ):
        assert (mine.unicode, mine.latex.replace(" ", "")) == (formula.unicode, formula.latex.replace("{V}", "V"))


def test_a_sentence_is_a_str_for_all_who_compare_store_or_copy_it():
    text = sentence("{V} of {e}", e=ERROR)
    assert json.loads(json.dumps({text: text})) == {"V of q - q_d": "V of q - q_d"}
    assert {text} == {"V of q - q_d"}
    for other in (pickle.loads(pickle.dumps(text)), copy.deepcopy(text)):
        assert (other, other.marked) == (text, text.marked)


def test_what_a_statement_is_about_is_typeset_as_the_law_that_it_comes_from():
    graph = Graph.read("observed_tracking_pi")
    diagram = graph.diagram
    printed = {term.vector.latex for law in laws_of(diagram).values() for term in (*law.storage, *law.dissipation)}
    from dmframe.certify import verify

    about = {item.signal.latex for item in verify(diagram, trials=1).statements}
    assert r"\tfrac{1}{2} \hat{J}^\top (x_{o} - x) + s/\beta" in about & printed
    assert r"\tfrac{d}{dt} (x - x_{d})" in about


def test_no_words_are_no_piece_of_a_formula():
    name = Text("", name_of("J_hat"), Text())
    assert name.pieces == (name_of("J_hat"),)
    assert around(Text(name_of("x")), f"{name}'({{}})", rf"{name.latex}^\top ({{}})").latex == r"\hat{J}^\top (x)"
