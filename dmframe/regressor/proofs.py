"""Exact proofs of the structural properties of a robot's model that controllers rely on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, final

import casadi as ca

from dmframe.exact import ZeroTest, zero_test
from dmframe.exact.identity import Values
from dmframe.robot.chain import SerialChain
from dmframe.robot.symbolic import SymbolicRobot

ROTATIONS: Final = ".rotations"


@final
@dataclass(frozen=True)
class Proof:
    """Identity, decided for all poses, velocities, inertial and kinematic parameters, and gravity.

    Parameters
    ----------
    name, identity
        Name and formula.
    test
        Exact test; `test.zero` is True if the identity holds.
    control
        True if the same test refutes the identity with an injected fault; None if the fault has no effect, as in C for
        one joint.
    """

    name: str
    identity: str
    test: ZeroTest
    control: bool | None

    @property
    def holds(self) -> bool:
        """True if proved, and the injected fault is refuted."""
        return self.test.zero and self.control is not False


@final
@dataclass(frozen=True)
class Symbols:
    """A robot with free motions."""

    robot: SymbolicRobot
    q: Any
    dq: Any
    a: Any
    b: Any

    @classmethod
    def of(cls, robot: SymbolicRobot) -> Symbols:
        """Fresh symbols: q, dq, and two more velocities or accelerations a and b."""
        return cls(robot, *(ca.SX.sym(name, robot.n) for name in ("q", "dq", "a", "b")))

    def along(self, expression: Any, direction: Any) -> Any:
        """The derivative in q along a velocity."""
        return ca.reshape(ca.jtimes(ca.vec(expression), self.q, direction), *expression.shape)

    def test(self, expression: Any, more: Mapping[str, Any], *, trials: int, seed: int) -> ZeroTest:
        """Test an expression for zero; only the rotations, which must be orthogonal, have their values."""
        constants = self.robot.constants
        free = {"q": self.q, "dq": self.dq, "a": self.a, "b": self.b, **more}
        function = ca.Function(
            "identity",
            [*free.values(), *(c.symbol for c in constants)],
            [ca.densify(expression)],
            [*free, *(c.name.replace(".", "_") for c in constants)],
            ["residual"],
        )
        fixed: Values = {len(free) + k: c.values for k, c in enumerate(constants) if c.name.endswith(ROTATIONS)}
        return zero_test(function, values=fixed, trials=trials, seed=seed)


Claim = tuple[str, str, Any, Any, Mapping[str, Any]]
"""Name, identity, residual, residual with an injected fault, and additional symbols."""


def prove(
    chain: SerialChain, *, trials: int = 3, seed: int = 0, robot: SymbolicRobot | None = None
) -> tuple[Proof, ...]:
    r"""Prove the structural properties of a chain's model.

    Linearity of the Slotine-Li form in a_d, and in a_d only; its equality with M ddq_ref + C dq_ref + g; M symmetric;
    :math:`\sigma^\top(\dot M - 2C)\sigma = 0`; J the derivative of f; :math:`J\psi = Y_k a_k` and dJ/dt that of a
    Jacobian.

    Parameters
    ----------
    trials, seed
        Number of trials and seed of the exact tests; each trial draws random primes and points.
    robot
        Another symbolic model of the chain, for tests with a faulty one.

    References
    ----------
    [WangTAC2020]_ properties P2 to P4, and eqs. (4), (5).
    """
    s = Symbols.of(robot or SymbolicRobot(chain))
    found = []
    for name, identity, residual, faulty, more in (*_dynamic(s), *_kinematic(s)):
        test = s.test(residual, more, trials=trials, seed=seed)
        wrong = s.test(faulty, more, trials=1, seed=seed)
        same = test.zero and wrong.zero and s.test(faulty - residual, more, trials=1, seed=seed + 1).zero
        found.append(Proof(name, identity, test, None if same else not wrong.zero))
    return tuple(found)


def _dynamic(s: Symbols) -> Iterator[Claim]:
    r, q, dq, a, b = s.robot, s.q, s.dq, s.a, s.b
    p, weight = ca.SX.sym("p", r.inertia.numel()), ca.SX.sym("weight")

    def torque(inertia: Any) -> Any:
        return r.inverse_dynamics(q, dq, a, b, inertia)

    own, other = torque(r.inertia), torque(p)
    sum_of = torque(r.inertia + weight * p)
    yield (
        "linear in a_d",
        "tau(a + w p) = tau(a) + w tau(p), tau = M ddq_ref + C dq_ref + g",
        sum_of - own - weight * other,
        sum_of - own - 2 * weight * other,
        {"p": p, "weight": weight},
    )
    Y = r.regressor(q, dq, a, b)
    yield "regressor", "tau(p) = Y_d(q, dq, dq_ref, ddq_ref) p", other - Y @ p, other - 2 * (Y @ p), {"p": p}
    M, C, g = r.mass_matrix(q), r.coriolis(q, dq), r.gravity_torque(q)
    whole = M @ b + C @ a + g
    yield "composition", "tau = M ddq_ref + C dq_ref + g", own - whole, own - whole - M @ a, {}
    slope = ca.densify(ca.jacobian(own, b))
    yield "M symmetric", "d tau/d ddq_ref = M = M'", ca.horzcat(slope - slope.T, slope - M), slope + slope.T, {}
    dM = s.along(M, dq)
    skew = ca.dot(a, dM @ a) - 2 * ca.dot(a, C @ a)
    yield "dM/dt - 2C skew", "s'(dM/dt - 2 C(q, dq)) s = 0", skew, skew - ca.dot(a, C @ a), {}
    swapped = C @ a - r.coriolis(q, a) @ dq
    yield "Christoffel", "C(q, a) b = C(q, b) a", swapped, swapped + C @ a, {}


def _kinematic(s: Symbols) -> Iterator[Claim]:
    r, q, dq, a = s.robot, s.q, s.dq, s.a
    J = r.jacobian(q)
    slope = ca.densify(ca.jacobian(r.position(q), q))
    yield "Jacobian", "J = df/dq", J - slope, J - 2 * slope, {}
    revolute = all(joint.kind == "revolute" for joint in r.chain.joints)
    travel = ca.SX.zeros(r.m) if revolute else r.jacobian(q, ca.SX.zeros(r.k)) @ a
    product = r.kinematic_regressor(q, a) @ r.a_k
    text = "J psi = Y_k(q, psi) a_k" + ("" if revolute else " + J_p psi, J_p of the prismatic joints")
    yield "kinematic regressor", text, J @ a - product - travel, J @ a - 2 * product - travel, {}
    turned = s.along(J, dq) @ a
    yield (
        "dJ/dt",
        "(dJ/dt along dq) psi = (dJ/dt along psi) dq",
        turned - s.along(J, a) @ dq,
        turned + s.along(J, a) @ dq,
        {},
    )


def proof_page(chain: SerialChain, proofs: tuple[Proof, ...]) -> str:
    """The proofs as text."""
    width = max(len(proof.name) for proof in proofs)
    texts = max(len(proof.identity) for proof in proofs)
    lines = [f"{chain.name}, {chain.n} joints: for all poses, rates, inertial and kinematic parameters, and gravity"]
    lines += [f"  {p.name:<{width}}  {p.identity:<{texts}}  {_outcome(p)}" for p in proofs]
    return "\n".join(lines)


def _outcome(proof: Proof) -> str:
    if not proof.test.zero:
        return "REFUTED"
    if proof.control is None:
        return f"proved, error probability below 2^{proof.test.log2_error_bound:.0f}; an injected fault has no effect"
    if not proof.control:
        return "NOT PROVED: the test does not refute an injected fault"
    return f"proved, error probability below 2^{proof.test.log2_error_bound:.0f}; an injected fault is refuted"
