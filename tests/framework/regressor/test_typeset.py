"""Printed equations are the textbook's, and their values are Pinocchio's."""

from __future__ import annotations

import importlib.util
import itertools
import random
import re
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from latex2mathml.converter import convert

from dmframe.common.errors import ValueFault
from dmframe.regressor.base_parameters import base_parameters
from dmframe.regressor.export import polarised_regressor, tool_velocity
from dmframe.regressor.polynomial import Polynomial, expand, wave
from dmframe.regressor.readable import Groups, Style, terms_of
from dmframe.regressor.typeset import (
    Matrix,
    evaluate,
    largest_difference,
    latex,
    parallel_groups,
    plain_text,
    write_out,
)
from dmframe.robot.library import find_robot, load

UR10 = {"free": ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"], "hold": {"wrist_2_joint": -np.pi / 2}}


def symbolic(matrix: Matrix, n: int) -> Any:
    """The printed text, read by SymPy."""
    import sympy as sp

    q = sp.symbols(f"q_1:{n + 1}")

    def number(term: str) -> Any:
        product = sp.Integer(1)
        for factor in re.findall(r"(?:sin|cos)\([^)]*\)(?:\^\d+)?|\S+", term):
            base, _, power = factor.partition("^")
            waves = re.fullmatch(r"([sc])_(\d+)", base)
            if waves:
                angle = sum(q[int(digit) - 1] for digit in waves.group(2))
                value = sp.sin(angle) if waves.group(1) == "s" else sp.cos(angle)
            elif re.fullmatch(r"[\d.]+", base):
                value = sp.Rational(base)
            else:
                value = sp.Symbol(base)
            product *= value ** int(power or 1)
        return product

    rows = []
    for row in matrix.entries:
        texts = [Style(latex=False).sum(terms) for terms in row]
        split = [re.split(r" ([+-]) ", ("- " + t[1:]) if t.startswith("-") else "+ " + t) for t in texts]
        values = []
        for first, *rest in split:
            sign, text = first[0], first[2:]
            total = number(text) * (-1 if sign == "-" else 1)
            for mark, other in zip(rest[::2], rest[1::2], strict=True):
                total += number(other) * (-1 if mark == "-" else 1)
            values.append(total)
        rows.append(values)
    return sp.Matrix(rows)


def textbook() -> Any:
    """The closed form and the arm's model, in symbols."""
    folder = find_robot("arm2").urdf.parent
    spec = importlib.util.spec_from_file_location("arm2_closed_form", folder / "closed_form.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    import sys

    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_the_planar_arms_equations_are_the_textbooks(monkeypatch: pytest.MonkeyPatch) -> None:
    import sympy as sp

    book = textbook()
    monkeypatch.setattr(book, "np", SimpleNamespace(cos=sp.cos, sin=sp.sin, array=sp.Matrix))
    names = "a_1 a_2 l_1 l_2 m_1 m_2 I_1 I_2 g_0"
    a_1, a_2, l_1, l_2, m_1, m_2, I_1, I_2, g_0 = sp.symbols(names)
    p = book.Parameters(a_1, a_2, l_1, l_2, m_1, m_2, I_1, I_2, g_0)
    q, dq = sp.symbols("q_1 q_2"), sp.symbols("dq_1 dq_2")
    dq_ref, ddq_ref = sp.symbols("dq_ref_1 dq_ref_2"), sp.symbols("ddq_ref_1 ddq_ref_2")
    meaning = {
        "p_x2": a_1, "p_x3": a_2, "m_2": m_2, "mc_x1": m_1 * l_1, "mc_x2": m_2 * l_2,
        "I_yy1": I_1 + m_1 * l_1**2, "I_yy2": I_2 + m_2 * l_2**2, "mc_z1": 0, "mc_z2": 0, "p_z2": 0, "p_z3": 0,
    }  # fmt: skip
    values = {sp.Symbol(name): value for name, value in meaning.items()}
    written = write_out(load("arm2"))

    def same(found: Any, expected: Any) -> bool:
        return bool(sp.expand_trig(sp.expand(found - expected)).applyfunc(sp.simplify).is_zero_matrix)

    M, C, g = book.mass_matrix(q, p), book.coriolis(q, dq, p), book.gravity_torque(q, p)
    assert same(symbolic(written.M, 2).subs(values), M)
    assert same(symbolic(written.C, 2).subs(values), C)
    assert same(symbolic(written.g, 2).subs(values), g)
    a_d = sp.Matrix([sp.Symbol(name) for name in written.Y_d.columns]).subs(values)
    torque = M @ sp.Matrix(ddq_ref) + C @ sp.Matrix(dq_ref) + g
    assert same(symbolic(written.Y_d, 2).subs(values) @ a_d, torque)
    a_k = sp.Matrix([sp.Symbol(name) for name in written.Y_k.columns]).subs(values)
    psi = sp.Matrix(sp.symbols("psi_1 psi_2"))
    assert same(symbolic(written.Y_k, 2).subs(values) @ a_k, book.jacobian(q, p) @ psi)


def test_the_planar_arms_mass_matrix_reads_as_in_a_book() -> None:
    assert plain_text(write_out(load("arm2")).M).splitlines()[:3] == [
        "M(q)",
        "  M_11 = p_x2^2 m_2 + 2 p_x2 mc_x2 c_2 + I_yy1 + I_yy2",
        "  M_12 = p_x2 mc_x2 c_2 + I_yy2",
    ]
    ur10 = plain_text(write_out(load("ur10", **UR10)).M)
    assert "I_xx2 c_2^2 + I_zz2 s_2^2 + I_xx3 c_23^2 + 2 I_xz3 c_23 s_23 + I_zz3 s_23^2" in ur10
    assert "2 p_z3 mc_z3 c_2 c_23" in ur10


@pytest.mark.parametrize(
    ("name", "options"),
    [("pendulum", {}), ("arm2", {}), ("arm3", {}), ("ur10", UR10), ("xarm7", {"free": ["joint1", "joint2", "joint3"]})],
)
def test_what_is_printed_is_what_pinocchio_computes(name: str, options: dict[str, Any]) -> None:
    chain = load(name, **options)
    written = write_out(chain)
    assert largest_difference(written) < 1e-9
    rng = np.random.default_rng(1)
    q, dq, dq_ref, ddq_ref = rng.uniform(-2, 2, (4, chain.n))
    signals = {"dq": dq, "dq_ref": dq_ref, "ddq_ref": ddq_ref, "psi": dq}
    numbers = written.numbers | {f"{k}_{i + 1}": v for k, x in signals.items() for i, v in enumerate(x)}
    from dmframe.robot.parameters import DynamicParameters

    columns = [DynamicParameters(chain).names.index(column) for column in written.Y_d.columns]
    expected = polarised_regressor(chain, q, dq, dq_ref, ddq_ref)
    assert np.allclose(evaluate(written.Y_d, numbers, q), expected[:, columns], atol=1e-8)
    left = np.delete(expected, columns, axis=1)
    assert np.allclose(left, 0, atol=1e-8)
    a_k = np.array([numbers[column] for column in written.Y_k.columns])
    assert np.allclose(evaluate(written.Y_k, numbers, q) @ a_k, tool_velocity(chain, q, dq), atol=1e-8)


def test_a_difference_from_pinocchio_is_seen() -> None:
    written = write_out(load("arm2"))
    written.numbers["mc_x2"] *= 1.001
    assert largest_difference(written) > 1e-5


def test_friction_and_base_columns_are_those_requested() -> None:
    chain = load("arm2")
    base = base_parameters(chain, ["viscous", "coulomb"])
    written = write_out(chain, ["viscous", "coulomb"], base.independent)
    assert written.Y_d.columns == base.kept
    text = plain_text(written.Y_d)
    assert "Y_d[1, B_1] = dq_ref_1" in text
    assert "Y_d[2, D_2] = phi_2" in text
    assert r"Y_d[2, D_{2}] &= \varphi(\dot q_{\mathrm r2})" in latex(written)


def test_the_latex_is_well_formed_and_states_what_is_left_out() -> None:
    text = latex(write_out(load("ur10", **UR10)))
    lines = [line for line in text.splitlines() if not line.startswith("%")]
    for line in "\n".join(lines).replace("&", "").split(r"\\"):
        body = re.sub(r"\\(begin|end)\{align\*\}|\\\[|\\\]|\\quad", "", line).strip()
        assert body.count("{") == body.count("}")
        assert "merror" not in convert(body)
    assert text.count(r"\begin{align*}") == text.count(r"\end{align*}") == 5
    assert "% Zero in the model, and left out of M, C and g: " in latex(write_out(load("arm2")))
    assert r"\cos(2 q_{2} + q_{3})" in text


def test_a_robot_too_large_to_print_is_reported_with_its_size() -> None:
    with pytest.raises(ValueFault, match=r"ur10: expected at most 3 joints to write out, found 6, whose Y_d takes \d+"):
        write_out(load("ur10"))


def test_only_exactly_parallel_neighbours_share_a_sum_of_angles() -> None:
    assert parallel_groups(load("arm3")).members == ((0, (1, 1, 1)),)
    assert parallel_groups(load("ur10", **UR10)).members == ((0, (1,)), (1, (1, 1)))
    assert all(len(signs) == 1 for _, signs in parallel_groups(load("panda")).members)


def test_folding_keeps_the_value_of_any_sum_of_waves() -> None:
    rng = random.Random(0)
    groups = Groups(((0, (1, 1)), (2, (1, -1))), 4)
    angles = np.array([0.3, -1.1, 0.7, 2.2])
    for _ in range(40):
        total = Polynomial({})
        for _ in range(rng.randrange(1, 6)):
            factor = Polynomial.number(Fraction(rng.randrange(-3, 4), rng.choice([1, 2])))
            for group in rng.sample([0, 1], rng.randrange(1, 3)):
                factor = factor * wave(group, rng.random() < 0.5, [rng.randrange(-2, 3), rng.randrange(-2, 3)])
            total = total + factor
        expected = 0.0
        for key, value in total.terms.items():
            parts = [(w, angles[:2] if w.group == 0 else angles[2:]) for w in key.waves]
            expected += float(value) * np.prod([np.sin(a @ w.k) if w.sine else np.cos(a @ w.k) for w, a in parts])
        found = sum(term.at({}, angles) for term in terms_of(total, groups, {}))
        assert found == pytest.approx(float(expected), abs=1e-12)


def test_expansion_refuses_what_is_not_a_polynomial() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(ValueFault, match="f: expected sums and products of symbols, sines and cosines, found CasADi's"):
        expand(ca.Function("f", [x], [ca.tanh(x)]), [[Polynomial.symbol("x")]])
    with pytest.raises(ValueFault, match="found CasADi's instruction"):
        expand(ca.Function("f", [x], [ca.sin(2 * x)]), [[(0, (1,))]])


def test_products_of_waves_are_those_of_numbers() -> None:
    angles = np.array([0.4, 1.3])
    for left, right in itertools.product(itertools.product([False, True], [(1, 0), (1, -1), (2, 1)]), repeat=2):
        a, b = wave(0, *left), wave(0, *right)

        def at(polynomial: Polynomial) -> float:
            groups = Groups(((0, (1, 1)),), 2)
            return sum(term.at({}, angles) for term in terms_of(polynomial, groups, {}))

        assert at(a * b) == pytest.approx(at(a) * at(b), abs=1e-14)
