"""Expressions of the code as a reader writes them, in three dialects."""

from __future__ import annotations

import casadi as ca
import pytest

from dmframe.formula.formula import Formula
from dmframe.formula.names import distinct, latex_name, unicode_name
from dmframe.formula.read import UnreadableError, read
from dmframe.linalg import solve_spd

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
    "e[:2]": (e[:2], "e[1:2]"),
    "A[:, 1]": (A[:, 1], "A[:,2]"),
    "A[1, 2]": (A[1, 2], "A[2,3]"),
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


def test_what_has_no_sign_is_refused():
    with pytest.raises(UnreadableError, match="no sign"):
        read(ca.det(A))
    with pytest.raises(UnreadableError, match="longer"):
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
}


@pytest.mark.parametrize("name", NAMES)
def test_a_name_prints_as_its_symbol(name):
    assert (latex_name(name), unicode_name(name)) == NAMES[name]


def test_two_names_that_print_alike_are_found():
    assert distinct(["x_1", "x1", "q"]) == [("x_1", "x1")]
