r"""The twin's equations: a servo of one family on each joint, and the robot's dynamics in base parameters.

.. math::

    \tau_j        &= (f_j \dot q_{c,j} + a_j q_{c,j} - b_j q_j - \dot q_j) / w_j + z_j                    \tag{1} \\
    \dot z_j      &= c_j (q_{c,j} - q_j) / w_j                                                             \tag{2} \\
    M(q, \beta) \ddot q + h(q, \dot q, \beta)
                  &= \tau - B \dot q - (D + S e^{-(\dot q / v_s)^2} + L |\tau|) \tanh(\dot q / v_0)  \tag{3}

q and q_c in (1) are deviations from the first position of the log. Initially z holds the robot: :math:`z(0) = h + o`,
with the offset o. PID servo: f = 1, a = b = k_P, c = k_I. PI servo: f = 1, a = b = k_I, c = 0. P-PI cascade with gains
p and i: a = p + f i, b = p + i, c = p i.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.block.linalg import solve_spd
from dmframe.diagram.rosenbrock import ROS34PW2
from dmframe.regressor.base_parameters import BaseParameters, base_parameters
from dmframe.robot.chain import SerialChain
from dmframe.robot.symbolic import SymbolicRobot

Array = np.ndarray

JOINT: Final = ("f", "a", "b", "c", "w", "B", "D", "S", "L", "offset", "q_0", "dq_0", "e_0")
"""Numbers of each joint: (1) to (3), and q, dq and q_c - q at the first sample."""
SHARED: Final = ("v_0", "v_s", "delay")
"""Numbers of all joints: velocities of the friction law [rad/s], and the delay [s] relative to the schedule's."""


SLOTS: Final = 24
"""Most unknown parts of the commands, as of lost samples."""


@final
@dataclass(frozen=True, eq=False)
class Model:
    """Functions of the twin for a robot.

    Parameters
    ----------
    chain
        The robot, as its file describes it.
    base
        Its base parameters, with the rotors' inertia.
    """

    chain: SerialChain
    base: BaseParameters

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.chain.n

    @cached_property
    def places(self) -> dict[str, slice]:
        """Places of the numbers in the twin's vector p: of joints, shared ones, commands, base parameters."""
        n, found, at = self.n, dict[str, slice](), 0
        for name in JOINT:
            found[name], at = slice(at, at + n), at + n
        for name in SHARED:
            found[name], at = slice(at, at + 1), at + 1
        found["command"], at = slice(at, at + SLOTS), at + SLOTS
        found["beta"] = slice(at, at + self.base.count)
        return found

    @property
    def size(self) -> int:
        """Length of p."""
        return int(self.places["beta"].stop)

    @cached_property
    def nominal(self) -> Array:
        """Base parameters of the robot's file, with rotors of no inertia."""
        values = np.array([0.0 if value is None else float(value) for value in self.base.parameters.values])
        return np.asarray(self.grouping @ values)

    @cached_property
    def grouping(self) -> Array:
        """Base parameters of all parameters, as numbers: (count, p)."""
        return np.array([[float(x) for x in row] for row in self.base.grouping])

    @cached_property
    def _robot(self) -> tuple[SymbolicRobot, Any, Any, Any, Any]:
        """The robot, its base parameters as symbols, all inertial parameters, rotors, and the robot's own numbers.

        Parameters that are not independent are zero: the motion depends on the base parameters only.
        """
        robot, beta = SymbolicRobot(self.chain), ca.SX.sym("beta", self.base.count)
        everything = ca.SX(self.base.parameters.size, 1)
        for k, column in enumerate(self.base.independent):
            everything[column] = beta[k]
        bodies = self.base.parameters.inertial
        fixed = [constant for constant in robot.constants if not constant.name.endswith(".inertia")]
        return robot, beta, everything[bodies], everything[self.base.parameters.places("rotor")], fixed

    def _numeric(self, *expressions: Any) -> list[Any]:
        fixed = self._robot[4]
        values = [ca.DM([float(value) for value in constant.values]) for constant in fixed]
        return list(ca.substitute(list(expressions), [constant.symbol for constant in fixed], values))

    @cached_property
    def rate(self) -> Any:
        """Function (x, dq_c, p) -> rate of x = (q, dq, q_c, z)."""
        n, (robot, beta, bodies, rotors, _) = self.n, self._robot
        x, u, p = ca.SX.sym("x", 4 * n), ca.SX.sym("u", n), ca.SX.sym("p", self.size)
        q, v, q_c = (x[k * n : (k + 1) * n] for k in range(3))
        tau, moved = self._torque(x, u, p)
        c, w, B, v_0 = (p[self.places[name]] for name in ("c", "w", "B", "v_0"))
        dry = self._dry(v, tau, p) * ca.tanh(v / v_0)
        M = robot.mass_matrix(q, bodies) + ca.diag(rotors)
        ddq = solve_spd(M, tau - B * v - dry - robot.inverse_dynamics(q, v, v, ca.SX(n, 1), bodies))
        [stated] = self._numeric(ca.vertcat(v, ddq, u, c * (q_c - moved) / w))
        [stated] = ca.substitute([stated], [beta], [p[self.places["beta"]]])
        return ca.Function("rate", [x, u, p], [ca.densify(stated)])

    def _torque(self, x: Any, u: Any, p: Any) -> tuple[Any, Any]:
        """The servo's torque (1) at a state x, and q relative to the first sample."""
        n = self.n
        q, v, q_c, z = (x[k * n : (k + 1) * n] for k in range(4))
        f, a, b, w, q_0 = (p[self.places[name]] for name in ("f", "a", "b", "w", "q_0"))
        return (f * u + a * q_c - b * (q - q_0) - v) / w + z, q - q_0

    def _dry(self, v: Any, tau: Any, p: Any) -> Any:
        """D + S exp(-(v/v_s)^2) + L |tau| of (3)."""
        D, S, L, v_s = (p[self.places[name]] for name in ("D", "S", "L", "v_s"))
        return D + S * decayed(v / v_s) + L * ca.fabs(tau)

    @cached_property
    def implicit(self) -> Any:
        r"""Function (x, p, h, rate) -> S, (n, n), of the linearly implicit integrator of `dmframe.identification.twin`.

        .. math::

            S = (M(q) + \gamma h K)^{-1} M(q), \quad
            K = \mathrm{diag}(1/w + B + (D + S e^{-(v/v_s)^2} + L |\tau|) / \sqrt{v_0^2 + v^2})

        with the slowest velocity v from the present one to that after an explicit step. The last term is near the
        secant of the friction law, tanh(v / v_0) / v, at least its slope. The method is stable with K from half of the
        slope to any multiple of it; with the slope at the present velocity, a light joint that stops would chatter.
        """
        n, (robot, beta, bodies, rotors, _) = self.n, self._robot
        x, p, h, rate = ca.SX.sym("x", 4 * n), ca.SX.sym("p", self.size), ca.SX.sym("h"), ca.SX.sym("rate", 4 * n)
        q, now = x[:n], x[n : 2 * n]
        after = now + h * rate[n : 2 * n]
        v = ca.fmax(ca.fmin(ca.fabs(now), ca.sign(now) * after), 0)
        w, B, v_0 = (p[self.places[name]] for name in ("w", "B", "v_0"))
        tau, _ = self._torque(x, rate[2 * n : 3 * n], p)  # the rate of q_c is the command
        K = 1 / w + B + self._dry(v, tau, p) / ca.sqrt(v_0 * v_0 + v * v)
        M = robot.mass_matrix(q, bodies) + ca.diag(rotors)
        [stated] = self._numeric(solve_spd(M + float(ROS34PW2.gamma) * h * ca.diag(K), M))
        [stated] = ca.substitute([stated], [beta], [p[self.places["beta"]]])
        return ca.Function("implicit", [x, p, h, rate], [ca.densify(stated)])

    @cached_property
    def inertia(self) -> Any:
        """Function (q, p) -> mass matrix of links and rotors (n, n)."""
        robot, beta, bodies, rotors, _ = self._robot
        q, p = ca.SX.sym("q", self.n), ca.SX.sym("p", self.size)
        [stated] = self._numeric(robot.mass_matrix(q, bodies) + ca.diag(rotors))
        [stated] = ca.substitute([stated], [beta], [p[self.places["beta"]]])
        return ca.Function("inertia", [q, p], [ca.densify(stated)])

    def physical(self, q: Array, p: Array) -> Array:
        """True for each column of p whose mass matrix is positive definite at all positions q, (count, n)."""
        poses, columns = np.repeat(q, p.shape[1], axis=0).T, np.tile(p, len(q))
        M = np.array(self.inertia.map(poses.shape[1])(poses, columns)).reshape(self.n, -1, self.n).transpose(1, 0, 2)
        least = np.full(len(M), -np.inf)
        finite = np.all(np.isfinite(M), axis=(1, 2))
        least[finite] = np.linalg.eigvalsh(M[finite])[:, 0]
        return np.asarray(np.all(least.reshape(len(q), -1) > 0, axis=0))

    @cached_property
    def begin(self) -> Any:
        """Function p -> x at the first sample."""
        robot, beta, bodies, _, _ = self._robot
        p = ca.SX.sym("p", self.size)
        q, v, e = (p[self.places[name]] for name in ("q_0", "dq_0", "e_0"))
        held = robot.gravity_torque(q, bodies) + p[self.places["offset"]]
        [stated] = self._numeric(ca.vertcat(q, v, e, held))
        [stated] = ca.substitute([stated], [beta], [p[self.places["beta"]]])
        return ca.Function("begin", [p], [ca.densify(stated)])

    @cached_property
    def torque_rows(self) -> Any:
        """Function (q, dq, ddq) -> Y (n, count) of the torque Y beta of links and rotors."""
        n, (robot, beta, bodies, rotors, _) = self.n, self._robot
        q, v, a = (ca.SX.sym(name, n) for name in ("q", "dq", "ddq"))
        tau = robot.inverse_dynamics(q, v, v, a, bodies) + rotors * a
        [rows] = self._numeric(ca.jacobian(tau, beta))
        return ca.Function("rows", [q, v, a], [ca.densify(rows)])


def decayed(slow: Any) -> Any:
    """exp(-slow^2), by a tanh, which has a SIMD form."""
    half = ca.tanh(slow * slow / 2)
    return (1 - half) / (1 + half)


def model_of(chain: SerialChain) -> Model:
    """The twin of a robot."""
    return Model(chain, base_parameters(chain, ("rotor",)))
