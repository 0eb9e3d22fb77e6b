"""The same identity by SymPy: from hand-written equations, and from dmframe's instructions."""

from __future__ import annotations

import random
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import casadi as ca
from closed_loops import loop_of

from dmframe.certify import Claim, claim_of
from dmframe.certify.claim import total
from dmframe.certify.symbols import symbols_of
from dmframe.robot.library import load

if TYPE_CHECKING:
    import sympy as sp


def column(name: str, n: int = 2) -> sp.Matrix:
    import sympy as sp

    return sp.Matrix(sp.symbols(f"{name}1:{n + 1}"))


def times(a: sp.Matrix, b: sp.Matrix) -> sp.Matrix:
    return a.multiply_elementwise(b)


def inverse(a: sp.Matrix) -> sp.Matrix:
    return a.applyfunc(lambda x: 1 / x)


def by_hand(adaptation: int = -1) -> sp.Expr:
    """DV/dt + dissipation of a planar arm with a PI servo and joint tracking, eqs. (3), (6), (12), (14)-(16), (45)."""
    import sympy as sp

    c2, s2, g1, g12 = sp.symbols("c2 s2 g1 g12")  # cos q2, sin q2, and cos q1, cos(q1 + q2) of gravity
    alpha, kappa = sp.symbols("alpha kappa")
    dq, q_err, dq_d, ddq_d, i, q_c, q_r, w, w_I = map(column, "dq e dqd ddqd i qc qr w wI".split())
    K, K_P, K_I, B, L, L_I = map(column, "K KP KI B L LI".split())
    a, a_hat, G = (column(name, 7) for name in ("a", "ahat", "G"))

    def regressor(b: sp.Matrix, db: sp.Matrix) -> sp.Matrix:
        """Y of M db + C(q, dq) b + B b + g, linear in a = (five inertial parameters, two of friction)."""
        first = [db[0], 2 * c2 * db[0] + c2 * db[1] - s2 * (dq[1] * b[0] + (dq[0] + dq[1]) * b[1]), db[1], g1, g12]
        second = [0, c2 * db[0] + s2 * dq[0] * b[0], db[0] + db[1], 0, g12]
        return sp.Matrix([[*first, b[0], 0], [*second, 0, b[1]]])

    M = sp.Matrix([[a[0] + 2 * a[1] * c2, a[2] + a[1] * c2], [a[2] + a[1] * c2, a[2]]])
    dM = -a[1] * s2 * dq[1] * sp.Matrix([[2, 1], [1, 0]])
    truth = a.copy()
    B = truth[5:7, :]

    dq_ref = dq_d - alpha * q_err
    ddq_ref = ddq_d - alpha * (dq - dq_d)
    sigma = dq - dq_ref
    Y = regressor(dq_ref, ddq_ref)
    tau = Y * a_hat
    dq_c = dq_ref + times(w_I, q_r) + times(w, tau) - times(w_I, q_c)
    u = -times(K_P, dq - dq_c) - times(K_I, i)
    rest = regressor(dq, sp.zeros(2, 1)) * a  # C dq + B dq + g
    M_ddq = times(K, u) - rest

    K_star = times(K, K_P)
    e = i + q_c - q_r
    w_err, w_I_err = w - inverse(K_star), w_I - times(K_I, inverse(K_P))
    dw, dw_I = adaptation * times(times(L, tau), sigma), times(times(L_I, q_c - q_r), sigma)
    da = -times(G, Y.T * sigma)
    half = sp.Rational(1, 2)
    dV = (sigma.T * (M_ddq - M * ddq_ref) + half * sigma.T * dM * sigma)[0]
    dV += times(times(K, K_I), e).dot((dq - dq_c) + dq_c - dq_ref)
    dV += times(times(K_star, inverse(L)), w_err).dot(dw) + times(times(K_star, inverse(L_I)), w_I_err).dot(dw_I)
    dV += times(inverse(G), a_hat - a).dot(da)
    dissipation = times(K_star + B, sigma).dot(sigma)
    servo = kappa * (dV + dissipation)
    cascade = q_err.dot(dq - dq_d)
    b = q_err / 2 - sigma / alpha
    spent = 3 * alpha / 4 * q_err.dot(q_err) + alpha * b.dot(b) - sigma.dot(sigma) / alpha
    return sp.expand(servo + cascade + spent)


def test_sympy_proves_the_planar_arm_with_a_pi_servo_from_its_own_equations() -> None:
    assert by_hand() == 0


def test_sympy_refutes_the_same_arm_with_one_adaptation_law_turned_round() -> None:
    assert by_hand(adaptation=1) != 0


def translated(f: Any, inputs: list[list[Any]], circle: dict[Any, tuple[Any, Any]]) -> list[Any]:
    """A CasADi function's instructions, executed by SymPy; angles are points of the unit circle."""
    import sympy as sp

    binary = {
        ca.OP_ADD: lambda x, y: x + y,
        ca.OP_SUB: lambda x, y: x - y,
        ca.OP_MUL: lambda x, y: x * y,
        ca.OP_DIV: lambda x, y: x / y,
    }
    unary = {
        ca.OP_NEG: lambda x: -x,
        ca.OP_SQ: lambda x: x * x,
        ca.OP_TWICE: lambda x: 2 * x,
        ca.OP_INV: lambda x: sp.Integer(1) / x,
        ca.OP_COS: lambda x: circle[x][0],
        ca.OP_SIN: lambda x: circle[x][1],
    }
    work: dict[int, Any] = {}
    found = []
    for k in range(f.n_instructions()):
        code, read, write = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if code == ca.OP_OUTPUT:
            found.append(work[read[0]])
        elif code == ca.OP_INPUT:
            work[write[0]] = inputs[read[0]][read[1]]
        elif code == ca.OP_CONST:
            fraction = Fraction(f.instruction_constant(k))
            work[write[0]] = sp.Rational(fraction.numerator, fraction.denominator)
        elif code == ca.OP_TANH:
            work[write[0]] = sp.Rational(len(work) + 2, 7)  # any value: this loop has no Coulomb friction
        elif code in binary:
            work[write[0]] = sp.cancel(binary[code](work[read[0]], work[read[1]]))
        else:
            work[write[0]] = sp.cancel(unary[code](work[read[0]]))
    return found


def residual_of(claim: Claim) -> Any:
    """dV/dt plus the dissipation, minus all terms that may increase V, by CasADi's derivatives."""
    own = [claim.weight(part) * (part.dissipation - part.residual - part.lemma) for part in claim.parts]
    return claim.flow.unrecorded(claim.V) + total(own) - claim.consumption


def residual_in_sympy(kept: set[str], factor: int = 1) -> Any:
    """dmframe's residual with the first element of some signals as symbols, all others random fractions."""
    import sympy as sp

    diagram = loop_of(load("arm2"), "joint", "PI", friction="viscous").diagram
    claim = claim_of(diagram)
    symbols = symbols_of(claim)
    (adapting,) = (part for part in claim.parts if part.block == "dynamics")
    residual = residual_of(claim) + (factor - 1) * claim.flow.unrecorded(adapting.storage)
    f = symbols.function("residual", [residual])
    rng = random.Random(3)
    inputs: list[list[Any]] = []
    circle = {}
    for group in symbols.groups:
        values = [sp.Rational(rng.randint(1, 9), rng.randint(1, 9)) for _ in range(group.symbol.numel())]
        if group.values is not None:
            values = [sp.Rational(value.numerator, value.denominator) for value in group.values]
        if group.label in kept:
            values[0] = sp.Symbol(group.label.replace(".", "_"))
        if group.label == "arm.q":
            for angle in values:
                t = sp.Rational(rng.randint(1, 9), 10 + len(circle))
                circle[angle] = ((1 - t * t) / (1 + t * t), 2 * t / (1 + t * t))
        inputs.append(values)
    (found,) = translated(f, inputs, circle)
    return sp.cancel(found)


def test_sympy_finds_the_residual_of_the_framework_to_vanish() -> None:
    # With all symbols at once it is too large; these occur in every product of the adaptation and of the velocities.
    assert residual_in_sympy({"arm.dq"}) == 0
    assert residual_in_sympy({"inverse.w", "servo.i"}) == 0


def test_sympy_finds_a_residual_with_a_rate_counted_twice_not_to_vanish() -> None:
    assert residual_in_sympy({"inverse.w"}, factor=2) != 0
