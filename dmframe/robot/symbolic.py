r"""Equations of motion of a serial robot as CasADi expressions suitable for exact arithmetic.

The robot's numbers are symbols with rational values, since CasADi folds floating-point constants, which would break
exact certificates. The only literals are 0, 1, -1 and 1/2; the only operations are + - * /, and sin and cos of single
joint angles (and tanh in the friction law).
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from typing import Any, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dmframe.robot.bodies import Link, acceleration_field, bodies_of, carry, joint_torques, matrix, skew
from dmframe.robot.chain import SerialChain
from dmframe.robot.rational import Vector, decimal
from dmframe.robot.recursion import placed, repeated

NO_LIMIT = 1e9
"""Substitute for a missing limit: finite, for compiled code."""


@final
@dataclass(frozen=True, eq=False)
class Constant:
    """Named numbers of the robot: a column of symbols, and the rational value of each."""

    name: str
    symbol: Any
    values: Vector
    unit: str


@final
class SymbolicRobot:
    r"""Kinematics and dynamics of a :class:`SerialChain`, one method per quantity.

    n joints, m task coordinates, k = 3 (n + 1) kinematic parameters: the translation of each joint in its parent and
    the tool's in the last joint. The 10 n inertial parameters follow Pinocchio's order, joint by joint. Angles in rad,
    lengths in m, torques in N m (forces in N at prismatic joints).

    Attributes
    ----------
    constants : the robot's numbers, each a column of symbols with its rational values
        `inertia` (10 n), `a_k` (k), `gravity` and `rotations` (the entries that are not 0 or +-1), `friction_velocity`.
    inertia : SX (10 n), symbols of the inertial parameters
    a_k : SX (k), symbols of the kinematic parameters, with a literal 0 where the value is 0
    gravity : SX (3), likewise

    References
    ----------
    [WangTAC2020]_ eqs. (1) to (5).
    """

    def __init__(self, chain: SerialChain, prefix: str = "robot") -> None:
        self.chain = chain
        self.n, self.m, self.k = chain.n, chain.m, chain.k
        flatten = itertools.chain.from_iterable
        kinematic = _kinematic(chain)
        self._inertia = _constant(f"{prefix}.inertia", tuple(flatten(chain.inertia)), "")
        self._a_k = _constant(f"{prefix}.a_k", kinematic, "m")
        self._gravity = _constant(f"{prefix}.gravity", _nonzero(chain.gravity), "m/s^2")
        odd = [x for x in _turns(chain) if x not in (0, 1, -1)]
        self._rotations = _constant(f"{prefix}.rotations", tuple(odd), "")
        self._friction = _constant(f"{prefix}.friction_velocity", (decimal(chain.friction_velocity),), "rad/s")
        everything = (self._inertia, self._a_k, self._gravity, self._rotations, self._friction)
        self.constants: tuple[Constant, ...] = tuple(constant for constant in everything if constant.values)

        symbols = iter(ca.vertsplit(self._rotations.symbol) if odd else [])
        self._placements = []
        for joint in chain.joints:
            rotation = [[_entry(x, symbols) for x in row] for row in joint.rotation]
            axis = [_entry(x, symbols) for x in joint.axis]
            self._placements.append((matrix(rotation), ca.vertcat(*axis)))
        self._tool_rotation = matrix([[_entry(x, symbols) for x in row] for row in chain.tool_rotation])
        symbols = iter(ca.vertsplit(self._gravity.symbol) if self._gravity.values else [])
        self.gravity = ca.vertcat(*(ca.SX(0) if x == 0 else next(symbols) for x in chain.gravity))
        pairs = zip(ca.vertsplit(self._a_k.symbol), kinematic, strict=True)
        self.a_k = ca.vertcat(*(ca.SX(0) if value == 0 else symbol for symbol, value in pairs))
        self.inertia = self._inertia.symbol
        self._stated: dict[str, tuple[list[Any], Any]] = {}
        self._placed = placed(chain, (*_turns(chain), *kinematic, *chain.gravity))

    def with_numbers(self, chain: SerialChain) -> SymbolicRobot:
        """Same symbols with the values of another chain with the same joints.

        Expressions in the symbols do not change; this reveals code that reads the values themselves.
        """
        other = copy.copy(self)
        other.chain = chain
        kept = [x != 0 for x in self.chain.gravity]
        pairs = zip(_turns(self.chain), _turns(chain), strict=True)
        values = {
            "inertia": tuple(itertools.chain.from_iterable(chain.inertia)),
            "a_k": _kinematic(chain),
            "gravity": tuple(itertools.compress(chain.gravity, kept)),
            "rotations": tuple(new for old, new in pairs if old not in (0, 1, -1)),
            "friction_velocity": (decimal(chain.friction_velocity),),
        }
        other.constants = tuple(replace(c, values=values[c.name.rpartition(".")[2]]) for c in self.constants)
        return other

    def with_free_axes(self) -> tuple[SymbolicRobot, Any, Any]:
        """Copy with all axes and rotations as symbols; and columns of these symbols, for joints and tool."""
        other = copy.copy(self)
        other._stated, other._placed = {}, ()
        other._placements = [(ca.SX.sym("rotation", 3, 3), ca.SX.sym("axis", 3)) for _ in self._placements]
        other._tool_rotation = ca.SX.sym("tool_rotation", 3, 3)
        axes = ca.vertcat(*(ca.vertcat(ca.vec(R), a) for R, a in other._placements))
        return other, axes, ca.vec(other._tool_rotation)

    def values(self) -> dict[str, NDArray[np.float64]]:
        """Numeric values of the constants by name."""
        return {constant.name: np.array([float(x) for x in constant.values]) for constant in self.constants}

    # Kinematics

    def position(self, q: Any, a_k: Any = None) -> Any:
        """Task position x = f(q), eq. (1): the tool's coordinates `axes` in the base frame, SX (m)."""
        offsets = self._offsets(a_k)
        point = offsets[-1]
        for link in reversed(self.links(q, a_k)):
            point = link.offset + link.rotation @ point
        return self._task(point)

    def jacobian(self, q: Any, a_k: Any = None) -> Any:
        r"""Task Jacobian J(q), eq. (2), SX (m, n); columns :math:`z_i \times (x - o_i)`, prismatic :math:`z_i`."""
        rotation, origin = ca.SX.eye(3), ca.SX(3, 1)
        axes, origins = [], []
        for link in self.links(q, a_k):
            origin = origin + rotation @ link.offset
            rotation = rotation @ link.rotation
            axes.append(rotation @ link.axis)
            origins.append(origin)
        tool = origin + rotation @ self._offsets(a_k)[-1]
        columns = [
            ca.cross(axis, tool - origin) if joint.kind == "revolute" else axis
            for joint, axis, origin in zip(self.chain.joints, axes, origins, strict=True)
        ]
        return self._task(ca.horzcat(*columns))

    def rotation(self, q: Any) -> Any:
        r"""Tool orientation R(q), SX (3, 3), from the tool's frame to the base's.

        Exactly orthogonal if sine and cosine are those of angles. For a tool given as an offset only, the tool's frame
        is that of the last joint.
        """
        R = ca.SX.eye(3)
        for link in self.links(q):
            R = R @ link.rotation
        return ca.densify(R @ self._tool_rotation)

    def angular_jacobian(self, q: Any) -> Any:
        r"""Angular Jacobian J_w(q) of the tool in the base's axes, :math:`\omega = J_w(q) \dot q`, SX (3, n).

        :math:`\dot R = [\omega]_\times R`. Columns :math:`z_i`, zero for a prismatic joint; independent of lengths.
        """
        R, axes = ca.SX.eye(3), []
        for link in self.links(q):
            R = R @ link.rotation
            axes.append(R @ link.axis if link.revolute else ca.SX(3, 1))
        return ca.densify(ca.horzcat(*axes))

    def kinematic_regressor(self, q: Any, psi: Any) -> Any:
        r"""Kinematic regressor Y_k(q, psi): :math:`J(q)\psi = Y_k(q, \psi) a_k + J_p(q)\psi`, eq. (4), SX (m, k).

        :math:`J_p`, the part that no parameter scales, is due to prismatic joints; with revolute joints
        :math:`J(q)\psi = Y_k a_k`.
        """
        a_k = ca.SX.sym("a_k", self.k)
        return ca.jacobian(self.jacobian(q, a_k) @ psi, a_k)

    def position_regressor(self, q: Any) -> Any:
        r"""Position regressor W_k(q): :math:`f(q) = W_k(q) a_k + f_p(q)`, SX (m, k); :math:`f_p`: prismatic joints."""
        a_k = ca.SX.sym("a_k", self.k)
        return ca.densify(ca.jacobian(self.position(q, a_k), a_k))

    # Dynamics

    def inverse_dynamics(
        self, q: Any, dq: Any, dq_ref: Any, ddq_ref: Any, inertia: Any = None, gravity_share: Any = 1
    ) -> Any:
        r"""Torque :math:`M(q)\ddot q_{ref} + C(q,\dot q)\dot q_{ref} + g(q)`, eqs. (3) and (5), SX (n).

        The Newton-Euler recursion with every product of two velocities polarised,
        :math:`\tfrac12 (p(\dot q) r(\dot q_{ref}) + p(\dot q_{ref}) r(\dot q))`, because :math:`C(q,a)b` with the
        Christoffel C is the symmetric bilinear form of the velocity terms. One O(n) pass, linear in the inertial
        parameters. If `dq_ref` is `dq`, the products are not polarised, and fewer.

        Parameters
        ----------
        q, dq, dq_ref, ddq_ref : SX (n)
        inertia : SX (10 n), by default of the robot
        gravity_share : SX, fraction of g(q) that is included

        References
        ----------
        [SlotineLi1987]_; [NiemeyerSlotine1991]_ for the recursion.
        """
        inertia, share = self.inertia if inertia is None else inertia, ca.SX(gravity_share)
        plain = bool(ca.is_equal(dq_ref, dq))
        given = (q, dq, ddq_ref, inertia, share, *(() if plain else (dq_ref,)))
        return repeated(partial(self._torque, plain), self._placed, given, [each.symbol for each in self.constants])

    def _torque(
        self, plain: bool, q: Any, dq: Any, ddq_ref: Any, inertia: Any, gravity_share: Any, dq_ref: Any = None
    ) -> Any:
        """Implementation of `inverse_dynamics`; with `plain`, `dq_ref` is `dq`."""
        links = self.links(q)
        h = bodies_of(inertia)
        omega = nu = dnu = ca.SX(3, 1)
        dq_ref = dq if plain else dq_ref
        acceleration = -self.gravity * gravity_share
        A = ca.SX(3, 3)
        forces = []
        for i, link in enumerate(links):
            R_t, a = link.rotation.T, link.axis
            acceleration = R_t @ (acceleration + A @ link.offset)
            omega, nu, dnu = R_t @ omega, R_t @ nu, R_t @ dnu
            if link.revolute:
                spin = omega * dq[i] if plain else omega * (dq_ref[i] * 0.5) + nu * (dq[i] * 0.5)
                dnu += a * ddq_ref[i] + ca.cross(spin, a)
                omega, nu = omega + a * dq[i], nu + a * dq_ref[i]
            else:
                acceleration += a * ddq_ref[i] + ca.cross(omega * dq_ref[i] + nu * dq[i], a)
            A, B = acceleration_field(omega, omega if plain else nu, dnu)
            forces.append(h[i].wrench(acceleration, dnu, A, B))
        return joint_torques(links, forces)

    def regressor(self, q: Any, dq: Any, dq_ref: Any, ddq_ref: Any) -> Any:
        r"""Dynamic regressor Y_d(q, dq, dq_ref, ddq_ref), eq. (5) without friction, SX (n, 10 n)."""
        return ca.jacobian(self.inverse_dynamics(q, dq, dq_ref, ddq_ref), self.inertia)

    def momentum_regressor(self, q: Any, dq: Any) -> Any:
        r"""Momentum regressor Y_p(q, dq): joint momentum :math:`M(q) \dot q = Y_p a`, SX (n, 10 n)."""

        def stated(at: Any, along: Any) -> Any:
            still = ca.SX(self.n, 1)
            return ca.jacobian(self.inverse_dynamics(at, still, still, along, gravity_share=0), self.inertia)

        return self._at("momentum", stated, q, dq)

    def kinetic_regressor(self, q: Any, dq: Any) -> Any:
        r"""Kinetic regressor: :math:`\partial_q (\tfrac12 \dot q^\top M(q) \dot q) = C(q, \dot q)^\top \dot q = Y_c a`,
        SX (n, 10 n), the rate of the momentum in addition to the applied torques: :math:`\dot M = C + C^\top`.
        """

        def stated(at: Any, along: Any) -> Any:
            still = ca.SX(self.n, 1)
            energy = ca.dot(along, self.inverse_dynamics(at, still, still, along, gravity_share=0)) / 2
            return ca.jacobian(ca.gradient(energy, at), self.inertia)

        return self._at("kinetic", stated, q, dq)

    def gravity_regressor(self, q: Any) -> Any:
        """Gravity regressor Y_g(q): g(q) = Y_g a, SX (n, 10 n)."""
        return self._at("gravity", lambda at: ca.jacobian(self.gravity_torque(at), self.inertia), q)

    def _at(self, name: str, stated: Callable[..., Any], *given: Any) -> Any:
        """Evaluate a function of columns of n, traced once with symbols, at other columns."""
        if name not in self._stated:
            symbols = [ca.SX.sym("x", self.n) for _ in given]
            self._stated[name] = symbols, stated(*symbols)
        symbols, expression = self._stated[name]
        return ca.substitute([expression], symbols, [ca.densify(x) for x in given])[0]

    def mass_matrix(self, q: Any, inertia: Any = None) -> Any:
        r"""Mass matrix M(q), SX (n, n), by composite bodies; symmetric by construction.

        References
        ----------
        [Featherstone2008]_ section 6.2.
        """
        links = self.links(q)
        composites = bodies_of(self.inertia if inertia is None else inertia)
        M = ca.SX(self.n, self.n)
        for i in reversed(range(self.n)):
            force, moment = composites[i].momentum(links[i])
            for j in range(i, -1, -1):
                link = links[j]
                M[i, j] = M[j, i] = ca.dot(link.axis, moment if link.revolute else force)
                force, moment = carry(link, force, moment)
            if i:
                composites[i - 1] = composites[i - 1] + composites[i].in_parent(links[i])
        return ca.densify(M)

    def coriolis(self, q: Any, dq: Any, inertia: Any = None) -> Any:
        r"""Christoffel matrix C(q, dq), SX (n, n): the Jacobian of :math:`C(q, \dot q) b` in b."""
        b = ca.SX.sym("b", self.n)
        zero = ca.SX(self.n, 1)
        return ca.densify(ca.jacobian(self.inverse_dynamics(q, dq, b, zero, inertia), b))

    def gravity_torque(self, q: Any, inertia: Any = None) -> Any:
        """Gravity torque g(q), SX (n)."""
        zero = ca.SX(self.n, 1)
        return self.inverse_dynamics(q, zero, zero, zero, inertia)

    def coulomb(self, dq: Any) -> Any:
        r"""Smooth sign :math:`\varphi(\dot q) = \tanh(\dot q / v_0)` of Coulomb friction, SX (n).

        :math:`v_0` is `friction_velocity` [rad/s]; the proofs require that the function is odd and increasing.
        """
        return ca.tanh(dq / self.friction_velocity)

    @property
    def friction_velocity(self) -> Any:
        """Velocity scale v_0 of `coulomb`, SX [rad/s]."""
        return self._friction.symbol

    @property
    def velocity_limits(self) -> Any:
        """Velocity limits of the joints, DM (n) [rad/s]; `NO_LIMIT` without one."""
        return _limits(joint.velocity if joint.velocity > 0 else math.inf for joint in self.chain.joints)

    @property
    def effort_limits(self) -> Any:
        """Torque limits of the joints, DM (n) [N m]; `NO_LIMIT` without one."""
        return _limits(joint.effort if joint.effort > 0 else math.inf for joint in self.chain.joints)

    @property
    def lower_limits(self) -> Any:
        """Lower angle limits of the joints, DM (n) [rad]; minus `NO_LIMIT` without one."""
        return -_limits(-joint.lower for joint in self.chain.joints)

    @property
    def upper_limits(self) -> Any:
        """Upper angle limits of the joints, DM (n) [rad]; `NO_LIMIT` without one."""
        return _limits(joint.upper for joint in self.chain.joints)

    def _task(self, rows: Any) -> Any:
        return ca.densify(rows[["xyz".index(letter) for letter in self.chain.axes], :])

    def _offsets(self, a_k: Any) -> list[Any]:
        return list(ca.vertsplit(self.a_k if a_k is None else a_k, 3))

    def links(self, q: Any, a_k: Any = None) -> list[Link]:
        """Transforms of the joints at q: rotation about the exact axis a, R = a a' + cos q (I - a a') + sin q [a]."""
        links = []
        joints = zip(self.chain.joints, self._placements, self._offsets(a_k)[:-1], ca.vertsplit(q), strict=True)
        for joint, (R, a), offset, angle in joints:
            if joint.kind == "prismatic":
                links.append(Link(False, a, R, offset + R @ a * angle))
                continue
            along = a @ a.T
            turn = along + ca.cos(angle) * (ca.SX.eye(3) - along) + ca.sin(angle) * skew(a)
            links.append(Link(True, a, ca.sparsify(R @ turn), offset))
        return links


def kinematics(chain: SerialChain) -> Any:
    """CasADi function q -> x, J with the numbers of the chain."""
    symbolic, q = SymbolicRobot(chain), ca.SX.sym("q", chain.n)
    symbols = ca.veccat(*(constant.symbol for constant in symbolic.constants))
    values = ca.veccat(*map(ca.DM, symbolic.values().values()))
    found = ca.substitute([symbolic.position(q), symbolic.jacobian(q)], [symbols], [values])
    return ca.Function("kinematics", [q], found)


def tool_position(chain: SerialChain) -> Any:
    """CasADi function q -> x with the numbers of the chain."""
    q = ca.SX.sym("q", chain.n)
    return ca.Function("tool", [q], [kinematics(chain)(q)[0]])


def _limits(values: Iterable[float]) -> Any:
    return ca.DM([min(value, NO_LIMIT) for value in values])


def _kinematic(chain: SerialChain) -> Vector:
    """a_k: translations of the joints and of the tool."""
    return tuple(x for joint in chain.joints for x in joint.translation) + chain.tool


def _turns(chain: SerialChain) -> Vector:
    """Rotation and axis of each joint, and the tool's rotation, by entry."""
    flatten = itertools.chain.from_iterable
    joints = (x for joint in chain.joints for x in (*flatten(joint.rotation), *joint.axis))
    return (*joints, *flatten(chain.tool_rotation))


def _constant(name: str, values: Vector, unit: str) -> Constant:
    return Constant(name, ca.SX.sym(name, len(values)), values, unit)


def _nonzero(values: Vector) -> Vector:
    return tuple(value for value in values if value != 0)


def _entry(value: Fraction, symbols: Any) -> Any:
    """Literal if the value is 0 or +-1, else the next symbol."""
    return ca.SX(int(value)) if value in (0, 1, -1) else next(symbols)
