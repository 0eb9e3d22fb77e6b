"""Expressions of the code as a reader would write them, in three dialects."""

from __future__ import annotations

from typing import Any

import casadi as ca
import pytest

from dmframe.block.linalg import solve_spd
from dmframe.block.naming import RESERVED, Naming, NamingError, derivative, named, operation, reading
from dmframe.block.terms import MONOTONE, norm
from dmframe.common.names import distinct, latex_name, unicode_name
from dmframe.formula.formula import Formula
from dmframe.formula.read import FUNCTIONS, UnreadableError, read
from dmframe.formula.robot import PAPER, SIGNS
from dmframe.formula.wrap import wrapped

N, M, P = 3, 2, 5


def column(name, rows=N):
    return ca.MX.sym(name, rows)


e, b, s, K = (column(name) for name in ("e", "b_hat", "sigma", "K_c"))
x, x_d = column("x", M), column("x_d", M)
J, Y, A = ca.MX.sym("J_hat", M, N), ca.MX.sym("Y_d", N, P), ca.MX.sym("A", N, N)
Gamma, a_d = column("Gamma", P), column("a_d_hat", P)
gamma, beta = ca.MX.sym("gamma"), ca.MX.sym("beta")

WRITTEN = {
    "J_hat'(x - x_d)/2 - sigma/gamma": (J.T @ (x - x_d) / 2 - s / gamma, r"½ Ĵᵀ(x − x_d) − σ/γ"),
    "3 gamma |e|^2/4": (3 * gamma / 4 * ca.dot(e, e), "¾ γ |e|²"),
    "-Gamma Y_d' sigma": (-Gamma * (Y.T @ s), "−Γ Y_dᵀ σ"),
    "e Y_d a_d_hat": ((Y @ a_d) * e, "e Y_d â_d"),
    "(Y_d a_d_hat)/e": ((Y @ a_d) / e, "(Y_d â_d)/e"),
    "Y_d (a_d_hat/Gamma)": (Y @ (a_d / Gamma), "Y_d (â_d/Γ)"),
    "(e' b_hat) sigma": (ca.dot(e, b) * s, "(eᵀ b̂) σ"),
    "gamma e' b_hat": (gamma * ca.dot(e, b), "γ eᵀ b̂"),
    "(K_c e)' b_hat": (ca.dot(K * e, b), "(K_c e)ᵀ b̂"),
    "J_hat'((J_hat J_hat')^-1 x - gamma (x - x_d))": (
        J.T @ (solve_spd(J @ J.T, x) - gamma * (x - x_d)),
        "Ĵᵀ((Ĵ Ĵᵀ)⁻¹ x − γ (x − x_d))",
    ),
    "e - (b_hat - sigma)": (e - (b - s), "e − (b̂ − σ)"),
    "-(e - b_hat)": (-(e - b), "−(e − b̂)"),
    "K_c A diag(K_c)": (ca.diag(K) @ A @ ca.diag(K), "K_c A diag(K_c)"),
    "A K_c b_hat": (A @ ca.diag(K) @ b, "A K_c b̂"),
    "[gamma I, A; A', 2 gamma I]": (
        ca.blockcat([[gamma * ca.DM.eye(N), A], [A.T, 2 * gamma * ca.DM.eye(N)]]),
        "[γ I, A; Aᵀ, 2 γ I]",
    ),
    "e_(1..2)": (e[:2], "e_(1…2)"),
    "e_3": (e[2], "e_3"),
    "(a_d_hat)_(4..5)": (a_d[3:], "(â_d)_(4…5)"),
    "A_(:,2)": (A[:, 1], "A_(:,2)"),
    "A_(2,3)": (A[1, 2], "A_(2,3)"),
    "A_(2,:)": (ca.vertsplit(A)[1], "A_(2,:)"),
    "A_(:,2..3)": (ca.horzsplit(A, [0, 1, 3])[1], "A_(:,2…3)"),
    "-b_hat": (e - (e + b), "−b̂"),
    "e + b_hat - (sigma + x)": (e + b - (s + column("x")), "e + b̂ − (σ + x)"),
    "(d(A' e/2)/de)": (derivative(A.T @ e / 2, e), "(∂(½ Aᵀ e)/∂e)"),
    "tanh(e/gamma)": (ca.tanh(e / gamma), "tanh(e/γ)"),
    "K_c/(2 gamma)": (K / (2 * gamma), "½ K_c/γ"),
    "e K_c/(b_hat sigma)": ((e * K) / (b * s), "e K_c/(b̂ σ)"),
    "gamma^2": (gamma**2, "γ²"),
    "e if gamma > 0, else b_hat": (ca.if_else(gamma > 0, e, b), "e if γ > 0, else b̂"),
    "min(1, max(-1, e))": (ca.fmin(ca.fmax(e, -1), 1), "min(1, max(−1, e))"),
    "sum(e b_hat)": (ca.sum1(e * b), "sum(e b̂)"),
    "(e, b_hat)": (ca.vertcat(e, b), "(e, b̂)"),
    "e' A b_hat": (ca.bilin(A, e, b), "eᵀ A b̂"),
    "e/10": (0.1 * e, "e/10"),
    "(A + A')/2": ((A + A.T) / 2, "½ (A + Aᵀ)"),
    "abs(e)": (ca.fabs(e), "|e|"),
}


@pytest.mark.parametrize("text", [text for text in WRITTEN if text != "abs(e)"])
def test_an_expression_prints_in_the_codes_names_and_in_unicode(text):
    expression, unicode = WRITTEN[text]
    formula = Formula(read(expression))
    assert formula.text == text
    assert formula.unicode == unicode


@pytest.mark.parametrize("text", WRITTEN)
def test_latex_has_its_braces_in_pairs(text):
    latex = Formula(read(WRITTEN[text][0])).latex
    assert latex.count("{") == latex.count("}")
    assert "_hat" not in latex


def test_latex_of_a_law_reads_as_in_the_paper():
    assert Formula(read(J.T @ (x - x_d) / 2 + s / beta)).latex == (
        r"\tfrac{1}{2} \hat{J}^\top (x - x_{d}) + \sigma/\beta"
    )


def test_pieces_in_latex_are_subscripts_and_count_from_one():
    assert Formula(read(a_d[3:])).latex == r"(\hat{a}_{d})_{4 \ldots 5}"
    assert Formula(read(A[:, :2])).latex == r"A_{:,1 \ldots 2}"
    assert Formula(read(e[1])).latex == "e_{2}"


def test_a_derivative_is_that_of_what_its_named_parts_represent():
    """For a = q^2, a' q / 2 has the gradient 3 q^2 / 2, and is printed with the name."""
    q, made = column("q", 1), Naming(lambda name, shape: ca.MX.sym(name, *shape), {})
    with reading(made):
        slope = derivative(named("a", q * q).T @ q / 2, q)
    symbol, meaning = made.definitions["a"]
    assert Formula(read(slope)).text == "(d(a q/2)/dq)"
    value = ca.Function("slope", [q], [ca.substitute([slope], [symbol], [meaning])[0]])
    assert float(value(3)) == pytest.approx(27 / 2)


LONG = "−|σ|²_(K_⋆ + B) − |q − q_r|²_(K M̄ K_c) + clip(σ, v)ᵀ K_⋆ ((w − 1/K_⋆) τ_dc − (w_I − K_I/K_D) z) − σᵀ(K u − B σ)"


@pytest.mark.parametrize("wide", [20, 30, 45, 60, 80, 100])
def test_a_long_formula_is_broken_before_a_sign_outside_of_all_brackets(wide):
    lines = wrapped(LONG, wide)
    assert " ".join(lines) == LONG
    assert max(map(len, lines)) <= wide
    assert all(line.count("|") % 2 == 0 for line in lines)  # never within a norm
    if wide >= 60:
        assert all(line[0] in "+−" and line.count("(") == line.count(")") for line in lines)


def test_accents_take_no_place_of_a_line():
    assert wrapped("ẏ + q̈ + b̂̇", 9) == ["ẏ + q̈ + b̂̇"]
    assert wrapped("½ |w − 1/K_⋆|²", 9) == ["½", "|w", "− 1/K_⋆|²"]  # no other term remains


def test_what_has_no_sign_is_refused():
    with pytest.raises(UnreadableError, match="without a printed symbol"):
        read(ca.det(A))
    with pytest.raises(UnreadableError, match="too long"):
        read(sum((ca.sin(k * e) for k in range(1, 600)), start=e))


NAMES = {
    "a_d_hat": (r"\hat{a}_{d}", "â_d"),
    "ddq_ref": (r"\ddot{q}_{\mathrm{ref}}", "q̈_ref"),
    "K_star": (r"K_{\star}", "K_⋆"),
    "M_bar": (r"\bar{M}", "M̄"),
    "alpha_bar": (r"\bar{\alpha}", "ᾱ"),
    "Lambda_P": (r"\Lambda_{P}", "Λ_P"),
    "dq_null": (r"\dot{q}_{\mathrm{null}}", "q̇_null"),
    "w(0)": ("w(0)", "w(0)"),
    "a_d_err": (r"\tilde{a}_{d}", "ã_d"),
    "maker_gravity": (r"\mathrm{maker\_gravity}", "maker_gravity"),
    "x_1": ("x_{1}", "x_1"),
    "lambda_": (r"\lambda", "λ"),
    "λ": (r"\lambda", "λ"),
    "λ_f": (r"\lambda_{f}", "λ_f"),
}


@pytest.mark.parametrize("name", NAMES)
def test_a_name_prints_as_its_symbol(name):
    assert (latex_name(name), unicode_name(name)) == NAMES[name]


def test_two_names_that_print_alike_are_found():
    assert distinct(["x_1", "x1", "q"]) == [("x_1", "x1")]
    assert distinct(["lambda_", "λ", "k"]) == [("lambda_", "λ")]
    assert distinct(["alpha", "α", "a_d_hat", "a_hat_d"]) == [("alpha", "α"), ("a_d_hat", "a_hat_d")]


def _called(name: str) -> Any:
    def function(a: Any) -> Any:
        """Three times `a`."""
        return 3 * a

    function.__name__ = function.__qualname__ = name
    return function


def test_an_operation_by_the_name_of_another_function_is_refused():
    known = {*FUNCTIONS.values(), *SIGNS.values(), *PAPER, *MONOTONE, "norm", "clip", "solve_spd", "derivative", "abs"}
    assert known <= RESERVED
    for name in ("norm", "tanh", "dot", "solve_spd", "derivative", "M"):
        with pytest.raises(NamingError, match=f"{name} prints as another function"):
            operation(_called(name))
    for name in ("<lambda>", "a + b", "\u0443"):
        with pytest.raises(NamingError, match="expected a function with a name such as saturated"):
            operation(_called(name))


def test_a_sign_of_its_own_has_the_function_and_not_its_name():
    imitated = _called("norm")
    imitated.__module__ = "dmframe.block.terms"
    x = ca.MX.sym("x", N)
    assert Formula(read(norm(x))).text == "|x|"
    assert Formula(read(operation(imitated)(x))).text == "norm(x)"
    assert Formula(read(norm(x))).text == "|x|"


def test_an_operation_of_a_text_that_is_run_has_a_sign_too():
    unplaced = _called("threefold")
    unplaced.__module__ = None
    assert Formula(read(operation(unplaced)(ca.MX.sym("x", N)))).text == "threefold(x)"
