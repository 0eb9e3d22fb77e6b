"""LaTeX read as numbers: the shapes determine the meaning of adjacent symbols."""

from __future__ import annotations

import numpy as np
import pytest

from dmframe.common.names import Symbol, symbol
from dmframe.formula.latex import evaluate, in_unicode, name_in, tokens
from dmframe.formula.matrices import UnreadableLatexError

rng = np.random.default_rng(0)
KNOWN = {
    "J_hat": rng.normal(size=(2, 3)),
    "x": rng.normal(size=(2, 1)),
    "e": rng.normal(size=(3, 1)),
    "K": rng.uniform(1, 2, size=(3, 1)),
    "gamma": np.array([[2.0]]),
    "A": rng.normal(size=(3, 3)) + 4 * np.eye(3),
}
J, x, e, K, A = (KNOWN[name] for name in ("J_hat", "x", "e", "K", "A"))


def look(name):
    return {symbol(key): value for key, value in KNOWN.items()}.get(name)


def value(text):
    return evaluate(tokens(text), look, lambda name, arguments: sum(arguments) if name == Symbol("f") else None)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (r"\hat J^\top x - K e", J.T @ x - K * e),
        (r"K e^\top e", K * (e.T @ e)),
        (r"\tfrac34 \gamma |e|^2", 1.5 * e.T @ e),
        (r"\frac{e}{\gamma}", e / 2),
        (r"|e|_{K/\gamma}^2", np.sum(K / 2 * e * e).reshape(1, 1)),
        (r"A^{-1} (e - K)", np.linalg.solve(A, e - K)),
        (r"(A + \gamma I) e", (A + 2 * np.eye(3)) @ e),
        (r"(e,\, x)", np.vstack([e, x])),
        (r"\begin{bmatrix} A & e \\ e^\top & \gamma \end{bmatrix}", np.block([[A, e], [e.T, np.array([[2.0]])]])),
        (r"\operatorname{diag}(K)\, A", np.diagflat(K) @ A),
        (r"\tanh(e/\gamma)", np.tanh(e / 2)),
        (r"f(e, K)", e + K),
        (r"-e^2", -(e**2)),
        (r"-\frac34 \cdot \gamma \cdot \lVert e - K \rVert^2", -1.5 * (e - K).T @ (e - K)),
        (r"\left| e \right|^2_{K} + \bigl\|e\bigr\|", np.sum(K * e * e).reshape(1, 1) + np.linalg.norm(e)),
    ],
)
def test_a_formula_is_its_numbers(text, expected):
    np.testing.assert_allclose(value(text), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        (r"x + e", "2 x 1 and 3 x 1 cannot be added"),
        (r"\hat J x", "2 x 3 and 2 x 1 cannot be multiplied"),
        (r"e / A", "not divided by"),
        (r"\int e", "not understood"),
        (r"e + ", "not understood"),
        (r"(e + K", "missing"),
        (r"|e", "not closed"),
        (r"e'", "prime"),
        (r"-\frac34 \times \gamma e", r"^\\times is not understood"),
        (r"\gamma \odot e", r"^\\odot is not understood"),
        (r"(\gamma e ; x)", r"^; is not understood"),
        (r"e ) + K", r"^\) is not understood here, before \+ K"),
        (r"q", "the name q is unknown$"),
        (r"\lambda e", "the name lambda is unknown; in code it is lambda_, since lambda is a word of Python$"),
    ],
)
def test_what_makes_no_sense_is_refused(text, reported):
    with pytest.raises(UnreadableLatexError, match=reported):
        value(text)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        (r"\dot{\hat a}_d", "da_d_hat"),
        (r"\ddot q_{ref}", "ddq_ref"),
        (r"K_\star", "K_star"),
        (r"a_{d,\mathrm{nominal}}", "a_d_nominal"),
        (r"\mathrm{maker\_gravity}", "maker_gravity"),
        (r"\bar\alpha", "alpha_bar"),
        (r"\lambda", "lambda_"),
        (r"\lambda_f", "lambda_f"),
        (r"\lambda", "λ"),
    ],
)
def test_a_name_is_that_of_the_code(text, name):
    found = name_in(tokens(text))
    assert found is not None
    assert found[0] == symbol(name)


@pytest.mark.parametrize(
    ("text", "unicode"),
    [
        (r"\dot q_{ref} = -K_2 y", "q̇_ref = −K_2 y"),
        (r"q_r", "q_r"),
        (r"\hat a_d \ge 0", "â_d ≥ 0"),
        (r"\tau_{bias}", "τ_bias"),
        (r"\hat J^\top (x - x_d)", "Ĵᵀ(x − x_d)"),
    ],
)
def test_a_short_formula_of_the_text_prints_in_a_terminal(text, unicode):
    assert in_unicode(text) == unicode
