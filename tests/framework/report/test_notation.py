from __future__ import annotations

import pytest

from dmframe.config import load_experiment
from dmframe.formula import laws_of
from dmframe.report.notation import latex, marked, signal_latex, spelled


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("w - 1/K_star", r"w - 1/K_{\star}"),
        ("J'(x - x_d)/2 - sigma/gamma", r"J^{\top} (x - x_{d})/2 - \sigma/\gamma"),
        ("q - q_r + K_c (i + z)", r"q - q_{r} + K_{c} (i + z)"),
        ("monotone friction", r"\text{monotone friction}"),
        ("50% of w_box", r"\text{50\% of w\_box}"),
    ],
)
def test_what_a_certificate_calls_its_squares_becomes_a_formula(text, expected):
    assert latex(text) == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("weight of |q - q_d|^2 in dV/dt > 0", r"weight of $|q - q_{d}|^2$ in $\dot V > 0$"),
        (
            "z'' + w_P z' + w_I z = 0 stays stable (give w_P_box)",
            r"$\ddot{z} + w_{P} \dot{z} + w_{I} z = 0$ stays stable (give `w_P_box`)",
        ),
        ("a signal that a proof needs", "a signal that a proof needs"),
        ("inverse.w_I: inside the box", "`inverse.w_I`: inside the box"),
        ("sign of d inverse.w/dt flipped", "sign of `d inverse.w/dt` flipped"),
        ("lower <= true value <= upper", "lower ≤ true value ≤ upper"),
        ("the maker's servo (7)", "the maker's servo (7)"),
        ("some kappa > 0 exists", r"some $\kappa > 0$ exists"),
        ("V(0) is all that there is (M(q) > 0)", "$V(0)$ is all that there is ($M(q) > 0$)"),
        ("A'P + P A < 0 at the corners", r"$A^{\top} P + P A < 0$ at the corners"),
        ("property P2", "property P2"),
        (r"my_block.py:18: \dot{w_P}: it holds no w", r"`my_block.py:18`: `\dot{w_P}`: it holds no $w$"),
        ("weight of |a_k_hat - tool(a_k)|^2 in V", r"weight of $|\hat{a}_{k} - \mathrm{tool}(a_{k})|^2$ in $V$"),
        ("geometry (adaptive_kinematics) knows x", "geometry (`adaptive_kinematics`) knows $x$"),
        ("|(a_k, b_k)|^2 > 0 (least pivot)", r"$|(a_{k},\; b_{k})|^2 > 0$ (least pivot)"),
        ("it is d(x - x_d)/dt, as all do", r"it is $d(x - x_{d})/dt$, as all do"),
        ("", ""),
    ],
)
def test_formulas_are_found_among_the_words_of_a_sentence(text, expected):
    assert marked(text) == expected


def test_what_a_statement_is_about_is_typeset_as_the_law_that_it_comes_from():
    laws = laws_of(load_experiment("observed_tracking_pi").diagram())
    assert signal_latex("x - x_d", laws) == "x - x_{d}"
    assert signal_latex("J_hat'(x_o - x)/2 + s/beta", laws) == (r"\tfrac{1}{2} \hat{J}^\top (x_{o} - x) + s/\beta")
    assert signal_latex("d(x - x_d)/dt", laws) == r"\tfrac{d}{dt} (x - x_{d})"
    assert signal_latex("x - x_d (task)", laws) == r"x - x_{d} \;\text{(task)}"
    assert signal_latex("q_c", laws) == "q_{c}"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "task: weight of |J_hat'(x - x_d)/2 - s/gamma|^2 in dV/dt >= 0",
            "task: weight of |Ĵᵀ(x − x_d)/2 − s/γ|² in V̇ ≥ 0",
        ),
        ("x - x_d goes to zero, if dy_dot does", "x − x_d goes to zero, if ẏ_dot does"),
        ("d(x - x_d)/dt goes to zero, as joints do", "d(x − x_d)/dt goes to zero, as joints do"),
        ("adaptation.a_d_hat: inside the box", "adaptation.a_d_hat: inside the box"),
        ("|a_k_hat - tool(a_k)|^2", "|â_k − tool(a_k)|²"),
        ("weight of |a_d|_W^2 in V", "weight of |a_d|²_W in V"),
    ],
)
def test_a_terminal_shows_the_formulas_of_a_sentence_in_unicode(text, expected):
    assert spelled(text) == expected
