"""The framework's expressions compared with textbook closed forms: in symbols for two links, in numbers for all."""

from __future__ import annotations

from fractions import Fraction

import casadi as ca
import numpy as np
import pytest

from dmframe.robot.library import load
from dmframe.robot.symbolic import SymbolicRobot
from dmframe_plants.arm2 import closed_form as arm2
from dmframe_plants.arm3 import closed_form as arm3
from dmframe_plants.pendulum import closed_form as pendulum

FORMS = {"arm2": arm2, "arm3": arm3, "pendulum": pendulum}
BINARY = {
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_MUL: lambda a, b: a * b,
    ca.OP_DIV: lambda a, b: a / b,
}
UNARY = {
    ca.OP_NEG: lambda a: -a,
    ca.OP_SQ: lambda a: a**2,
    ca.OP_TWICE: lambda a: 2 * a,
}


def to_sympy(f, inputs):
    """The outputs of an SX function as SymPy matrices, by its instruction tape."""
    import sympy as sp

    unary = {**UNARY, ca.OP_SIN: sp.sin, ca.OP_COS: sp.cos}
    work, outputs = {}, [sp.zeros(*f.size_out(i)) for i in range(f.n_out())]
    positions = [list(zip(*f.sparsity_out(i).get_triplet(), strict=True)) for i in range(f.n_out())]
    for i in range(f.n_instructions()):
        code, read, write = f.instruction_id(i), f.instruction_input(i), f.instruction_output(i)
        if code == ca.OP_INPUT:
            work[write[0]] = inputs[read[0]][read[1]]
        elif code == ca.OP_CONST:
            value = Fraction(f.instruction_constant(i))
            work[write[0]] = sp.Rational(value.numerator, value.denominator)
        elif code == ca.OP_OUTPUT:
            outputs[write[0]][positions[write[0]][write[1]]] = work[read[0]]
        elif code in unary:
            work[write[0]] = unary[code](work[read[0]])
        else:
            work[write[0]] = BINARY[code](work[read[0]], work[read[1]])
    return outputs


class Angle:
    """A SymPy angle that NumPy's sin and cos accept, so that the closed form runs on symbols unchanged."""

    def __init__(self, expression):
        self.expression = expression

    def __add__(self, other):
        return Angle(self.expression + other.expression)

    def sin(self):
        import sympy as sp

        return sp.sin(self.expression)

    def cos(self):
        import sympy as sp

        return sp.cos(self.expression)


def symbolic_arm2():
    """Angles, rates, parameters; and arm2's inertial parameters and translations in them."""
    import sympy as sp

    q, dq = sp.symbols("q_1 q_2", real=True), sp.symbols("dq_1 dq_2", real=True)
    p = arm2.Parameters(*sp.symbols("a_1 a_2 l_1 l_2 m_1 m_2 I_1 I_2 g_0", positive=True))
    others = iter(sp.symbols("I_xx1 I_zz1 I_xx2 I_zz2", positive=True))
    inertia = []
    for m, length, moment in ((p.m_1, p.l_1, p.I_1), (p.m_2, p.l_2, p.I_2)):
        about_joint = m * length**2
        inertia += [m, m * length, 0, 0, next(others), 0, moment + about_joint, 0, 0, next(others) + about_joint]
    a_k = [0, 0, 0, p.a_1, 0, 0, p.a_2, 0, 0]
    return q, dq, p, inertia, a_k


@pytest.fixture(scope="module")
def arm2_in_symbols():
    q, dq, p, inertia, a_k = symbolic_arm2()
    robot = SymbolicRobot(load("arm2"))
    names = [ca.SX.sym("q", 2), ca.SX.sym("dq", 2)]
    expressions = {
        "position": robot.position(names[0]),
        "jacobian": robot.jacobian(names[0]),
        "mass_matrix": robot.mass_matrix(names[0]),
        "coriolis": robot.coriolis(*names),
        "gravity_torque": robot.gravity_torque(names[0]),
    }
    values = {"robot.inertia": inertia, "robot.a_k": a_k, "robot.gravity": [-p.g_0], "robot.friction_velocity": [1]}
    inputs = [q, dq, *(values[c.name] for c in robot.constants)]
    f = ca.Function("f", [*names, *(c.symbol for c in robot.constants)], list(expressions.values()))
    return dict(zip(expressions, to_sympy(f, inputs), strict=True)), q, dq, p


@pytest.mark.parametrize("name", ["position", "jacobian", "mass_matrix", "coriolis", "gravity_torque"])
def test_arm2_is_the_textbooks_arm_symbol_by_symbol(arm2_in_symbols, name):
    import sympy as sp

    expressions, q, dq, p = arm2_in_symbols
    angles = [Angle(angle) for angle in q]
    arguments = (angles, dq) if name == "coriolis" else (angles,)
    expected = sp.Matrix(getattr(arm2, name)(*arguments, p))
    difference = (expressions[name] - expected).applyfunc(lambda entry: sp.simplify(sp.expand(sp.expand_trig(entry))))
    assert difference == sp.zeros(*expected.shape)
    assert expected != sp.zeros(*expected.shape)


def test_the_symbolic_comparison_detects_a_wrong_sign(arm2_in_symbols):
    import sympy as sp

    expressions, q, dq, p = arm2_in_symbols
    wrong = -sp.Matrix(arm2.coriolis([Angle(angle) for angle in q], dq, p))
    assert sp.simplify(expressions["coriolis"] - wrong) != sp.zeros(2, 2)


@pytest.mark.parametrize("name", FORMS)
def test_the_closed_form_gives_the_numbers_of_the_urdf(name):
    form, robot = FORMS[name], SymbolicRobot(load(name))
    q_symbol, dq_symbol = ca.SX.sym("q", robot.n), ca.SX.sym("dq", robot.n)
    expressions = [
        robot.position(q_symbol),
        robot.jacobian(q_symbol),
        robot.mass_matrix(q_symbol),
        robot.gravity_torque(q_symbol),
        robot.coriolis(q_symbol, dq_symbol),
    ]
    f = ca.Function("f", [q_symbol, dq_symbol, *(c.symbol for c in robot.constants)], expressions)
    for q, dq in np.random.default_rng(1).normal(size=(5, 2, robot.n)):
        found = [np.array(x) for x in f(q, dq, *robot.values().values())]
        expected = [
            form.position(q),
            form.jacobian(q),
            form.mass_matrix(q),
            form.gravity_torque(q),
            form.coriolis(q, dq),
        ]
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, other.reshape(one.shape), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("name", FORMS)
def test_the_closed_form_conserves_energy_by_skew_symmetry(name):
    form, n, step = FORMS[name], load(name).n, 1e-6
    q, dq, s = np.random.default_rng(2).normal(size=(3, n))
    rate = (form.mass_matrix(q + step * dq) - form.mass_matrix(q - step * dq)) / (2 * step)
    assert abs(s @ (rate - 2 * form.coriolis(q, dq)) @ s) < 1e-8
    assert np.all(np.linalg.eigvalsh(form.mass_matrix(q)) > 0)
