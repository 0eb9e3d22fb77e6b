"""Averaged model of a closed servo over one sample, linear in constant parameters of each joint.

Averaged over a sample of length T with the command u held, each joint of a robot behind a PID position servo satisfies

    u - v = psi' theta,    psi = (e, z + T e/2, 1, [Y_p(m, v) - Y_p before]/T - Y_c(m, v) + Y_g(m), v, phi(v))

up to the difference between averages of functions and functions of averages. Here v is the average velocity, m the
middle pose, e the error of the target at the middle, z the sum of T e over the earlier samples, and Y_p, Y_c, Y_g are
the joint's rows of the regressors. theta consists of K_P/K_D, K_I/K_D, an offset, w times the inertial parameters, and
w times the friction, with w = 1/(K K_D). For a PI velocity servo, e is the integral itself: the row is (e, 1, ...) and
theta is (K_I/K_P, offset, ...), with w = 1/(K K_P).

For a P-PI cascade with the fraction f of velocity feed-forward, tau = K_v (f u - k_p e - dq) + K_i xi, where xi is the
integral of the parenthesis, the row has two more columns, the command u and the target at the middle of the sample:

    u - v = (k_p + k_i) e + k_p k_i z + offset + (1 - f) u + k_i (1 - f) q_c + tau/K_v,    k_i = K_i/K_v

With `dynamics` "joints" the inertial columns of a joint are one, the change of its velocity over T: the joints are
not coupled, and gravity is part of the offset.

Rows and parameters of all joints are stacked in one column.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from typing import Any, Final, NamedTuple, final

import casadi as ca

from dmframe.block import Element, Expression, ldl, operation
from dmframe.robot.chain import SerialChain
from dmframe.robot.parameters import DynamicParameters, Friction
from dmframe.robot.symbolic import SymbolicRobot

SERVO: Final = {
    "pid": ("k_P", "k_I", "offset"),
    "pi": ("k_I", "offset"),
    "p_pi": ("k_P", "k_I", "offset", "k_u", "k_q"),
}
"""The identifiable constants of a joint's servo: gains divided by the velocity gain, K_P and K_I for a PID servo."""

STEEPEST: Final = 4
"""|w M/T| above which a command omits the change of momentum."""

LEAST: Final = 0.2
"""Least slope of the residual with respect to the command; a smaller estimate is taken for this one."""

_UNITS: Final = {"k_P": "1/s", "k_I": "1/s^2", "offset": "rad/s", "k_u": "", "k_q": "1/s"}
_FRICTION: Final[dict[Friction, str]] = {"viscous": "B", "coulomb": "D"}


@lru_cache(maxsize=8)
def averaged_servo(
    chain: SerialChain, servo: str, friction: frozenset[Friction], dynamics: str = "robot"
) -> AveragedServo:
    """The averaged model of a robot; one shared object per robot and options."""
    return AveragedServo(chain, servo, friction, dynamics)


class Start(NamedTuple):
    """Start of a sample: pose, target, sum of the errors; middle pose and average velocity of the previous sample."""

    q: Any
    target: Any
    z: Any
    m_before: Any
    v_before: Any


def _used(chain: SerialChain) -> Sequence[Sequence[int]]:
    """For each joint the inertial parameters that affect its torque, without columns of zeros."""
    robot, q, dq = SymbolicRobot(chain), ca.SX.sym("q", chain.n), ca.SX.sym("dq", chain.n)
    parts = robot.momentum_regressor(q, dq), robot.kinetic_regressor(q, dq), robot.gravity_regressor(q)
    pattern = ca.densify(sum(ca.DM(part.sparsity(), 1) for part in parts)).full()
    return [[k for k, entry in enumerate(row) if entry] for row in pattern]


@final
class AveragedServo:
    """The columns of the averaged model, and operations on them, each of which prints as one function.

    Attributes
    ----------
    joints, parts
        The part of the column that belongs to each joint, and its number of elements.
    size
        Number of elements of the column.
    elements
        Names and units of the elements of theta: k_P1, k_I1, offset1, w1_m_1, ..., w1_B, w1_D, k_P2, ...
    """

    def __init__(self, chain: SerialChain, servo: str, friction: frozenset[Friction], dynamics: str = "robot") -> None:
        self.chain, self.servo, self.friction = chain, SERVO[servo], [kind for kind in _FRICTION if kind in friction]
        self.coupled = dynamics == "robot"
        self._used = _used(chain) if self.coupled else [[0]] * chain.n
        self.joints, self.elements = list[slice](), list[Element]()
        inertial = DynamicParameters(chain).elements if self.coupled else [Element("inertia")]
        units = _UNITS if "k_P" in self.servo else {**_UNITS, "k_I": "1/s"}  # K_I/K_D, K_I/K_P
        for i, used in enumerate(self._used, start=1):
            first = len(self.elements)
            self.elements += [Element(f"{name}{i}", units[name]) for name in self.servo]
            self.elements += [Element(f"w{i}_{inertial[k].name}") for k in used]
            self.elements += [Element(f"w{i}_{_FRICTION[kind]}") for kind in self.friction]
            self.joints.append(slice(first, len(self.elements)))
        self.size, self.parts = len(self.elements), tuple(part.stop - part.start for part in self.joints)

    def momentum(self, robot: Any, q: Any, v: Any) -> Any:
        """The inertial columns of momentum; without coupling, the velocity."""
        return robot.momentum_regressor(q, v) if self.coupled else v

    def others(self, robot: Any, q: Any, v: Any) -> Any:
        """The inertial columns of gravity, without those of kinetic energy."""
        return robot.gravity_regressor(q) - robot.kinetic_regressor(q, v) if self.coupled else 0 * v

    @cached_property
    def row(self) -> Callable[..., Expression]:
        """Operation that assembles a row."""

        @operation
        def row(e: Any, sum_e: Any, one: Any, Y: Any, v: Any, phi: Any, *more: Any) -> Any:
            """The rows of all joints in one column, from the values of each joint; of a P-PI servo also u and q_c."""
            return self._row(e, sum_e, one, Y, v, phi, *more)

        return row

    @cached_property
    def answer(self) -> Callable[..., Expression]:
        """Operation psi' theta."""

        @operation
        def answer(psi: Any, theta: Any) -> Any:
            """The product of row and parameters, joint by joint."""
            return self._sums(psi * theta)

        return answer

    @cached_property
    def of_joint(self) -> Callable[..., Expression]:
        """Operation that gives each element the value of its joint."""

        @operation
        def of_joint(a: Any) -> Any:
            """The value of its joint for each element of a row."""
            return self._each(a)

        return of_joint

    @cached_property
    def changing(self) -> Callable[..., Expression]:
        """Operation that sets the constant of a row to zero."""

        @operation
        def changing(psi: Any) -> Any:
            """The row with zeros for its constants."""
            return psi * self._placed(1, 1, 0, 1, 1, *self.of_p_pi(1, 1))

        return changing

    @cached_property
    def kinds(self) -> Callable[..., Expression]:
        """Operation that gives each element the value of its kind."""

        @operation
        def kinds(k_P: Any, k_I: Any, offset: Any, inertia: Any, friction: Any, *more: Any) -> Any:
            """The value, or the interval, of its kind for each element of a row."""
            return self._placed(k_P, k_I, offset, inertia, friction, *more)

        return kinds

    @cached_property
    def updated(self) -> Callable[..., Expression]:
        """Operation that updates the estimate with rows."""

        @operation
        def updated(theta: Any, h: Any, g: Any, rows: Any, goals: Any, Gamma: Any, nu: Any, box: Any) -> Any:
            """The estimate after projections onto h, the stored rows, and h again, each clipped to the box."""
            stored = [(rows[k, :].T, goals[k, :].T) for k in range(rows.shape[0])]
            for seen, wanted in ((h, g), *stored, (h, g)):
                theta = self.projected(theta, seen, wanted, Gamma, nu)
                theta = ca.fmin(ca.fmax(theta, box[:, 0]), box[:, 1])
            return theta

        return updated

    def projected(self, theta: Any, h: Any, g: Any, Gamma: Any, nu: Any) -> Any:
        """Theta + Gamma h (g - h' theta)/(nu + h' Gamma h), joint by joint: the update by one row."""
        epsilon = g - self._sums(h * theta)
        return theta + Gamma * h * self._each(epsilon / (nu + self._sums(h * Gamma * h)))

    @cached_property
    def pushed(self) -> Callable[..., Expression]:
        """Operation that stores a row."""

        @operation
        def pushed(rows: Any, new: Any) -> Any:
            """The rows with a new first one, without the last."""
            return ca.vertcat(new.T, rows[:-1, :])

        return pushed

    @cached_property
    def total(self) -> Callable[..., Expression]:
        """Operation that adds rows."""

        @operation
        def total(rows: Any) -> Any:
            """The sum of the rows."""
            return ca.sum1(rows).T

        return total

    @cached_property
    def share(self) -> Callable[..., Expression]:
        """Operation that gives the sensitivity of the prediction to the command."""

        @operation
        def share(theta: Any, T: Any) -> Any:
            """Decrease of the prediction per unit of command: k_P T/2 + k_I T^2/4; k_I T/2 for a PI servo.

            A P-PI servo has k_u + k_q T/2 less, and 1 + share is at least `LEAST`.
            """
            share = self._share(theta, T)
            if "k_u" not in self.servo:
                return share
            return ca.fmax(LEAST - 1, share - theta[self._places("k_u")] - theta[self._places("k_q")] * T / 2)

        return share

    @cached_property
    def inertia(self) -> Callable[..., Expression]:
        """Operation that computes w M from the momentum regressors of unit velocities."""

        @operation
        def inertia(theta: Any, momenta: Any) -> Any:
            """The matrix whose row i is w times the momentum of joint i for unit velocities, by its own estimates."""
            n, still = self.chain.n, ca.SX.zeros(self.chain.n)
            units = ca.horzsplit(momenta, momenta.shape[1] // n)
            rows = (self._row(still, still, still, Y, still, still, *self.of_p_pi(still, still)) for Y in units)
            return ca.horzcat(*(self._sums(psi * theta) for psi in rows))

        return inertia

    @cached_property
    def safe(self) -> Callable[..., Expression]:
        """Operation that decides whether a command may use the change of momentum."""

        @operation
        def safe(S: Any, margin: Any) -> Any:
            """True if the symmetric part of (1/2 - margin) I + S is positive definite and the norm of S at most 4."""
            _, pivots = ldl(ca.DM.eye(self.chain.n) * (0.5 - margin) + (S + S.T) / 2)
            fine = ca.sumsqr(S) <= STEEPEST**2
            for pivot in pivots:
                fine = ca.logic_and(fine, pivot > 0)
            return fine

        return safe

    @cached_property
    def offset(self) -> Callable[..., Expression]:
        """Operation that selects the offsets."""

        @operation
        def offset(theta: Any) -> Any:
            """The offset of each joint."""
            return theta[self._places("offset")]

        return offset

    @cached_property
    def damping(self) -> Callable[..., Expression]:
        """Operation that gives the slope of the prediction with respect to velocity, without inertia."""

        @operation
        def damping(theta: Any, v: Any, v_0: Any, T: Any) -> Any:
            """Slope of the prediction in v, without inertia; Coulomb friction, which is steep at rest, as a secant."""
            slope = self._share(theta, T)
            for back, kind in enumerate(reversed(self.friction), start=1):
                element = theta[[part.stop - back for part in self.joints]]
                slope += element if kind == "viscous" else element / ca.sqrt(v_0 * v_0 + v * v)
            return slope

        return damping

    def gamma(self, p: Any) -> Any:
        """Squares of the expected deviations of the elements, from the parameters `..._size` of `SampledInverse`."""
        w, more = p.w_0, self.of_p_pi(p.k_u_size, p.k_q_size)
        scaled = w * p.offset_size, w * p.inertia_size, w * p.friction_size
        sizes = self.kinds(p.k_P_size, p.k_I_size, *scaled, *more)
        return sizes * sizes

    def box(self, p: Any) -> Any:
        """Lower and upper bounds of the elements, from the parameters `..._box`."""
        boxes = p.k_P_box, p.k_I_box, p.offset_box, p.w_0 @ p.inertia_box, p.w_0 @ p.friction_box
        return self.kinds(*boxes, *self.of_p_pi(p.k_u_box, p.k_q_box))

    def of_p_pi(self, k_u: Any, k_q: Any) -> tuple[Any, ...]:
        """What belongs to the further columns of a P-PI servo; empty for the others."""
        return (k_u, k_q) if self._more else ()

    @property
    def _more(self) -> tuple[str, ...]:
        return tuple(name for name in ("k_u", "k_q") if name in self.servo)

    def _row(self, e: Any, sum_e: Any, one: Any, Y: Any, v: Any, phi: Any, *more: Any) -> Any:
        servo = {"k_P": e, "k_I": sum_e, "offset": one, **dict(zip(self._more, more, strict=True))}
        friction = {"viscous": v, "coulomb": phi}
        if "k_P" not in self.servo:
            servo["k_I"] = e
        parts = list[Any]()
        for i, used in enumerate(self._used):
            parts += [servo[name][i] for name in self.servo]
            parts += [Y[i, k] for k in used]
            parts += [friction[kind][i] for kind in self.friction]
        return ca.vertcat(*parts)

    def _share(self, theta: Any, T: Any) -> Any:
        k_I = theta[self._places("k_I")]
        return k_I * T / 2 if "k_P" not in self.servo else theta[self._places("k_P")] * T / 2 + k_I * T * T / 4

    def _places(self, name: str) -> list[int]:
        return [part.start + self.servo.index(name) for part in self.joints]

    def _sums(self, products: Any) -> Any:
        return ca.vertcat(*(ca.sum1(products[part]) for part in self.joints))

    def _each(self, values: Any) -> Any:
        pairs = enumerate(self.joints)
        return ca.vertcat(*(ca.repmat(values[i], part.stop - part.start, 1) for i, part in pairs))

    def _placed(self, k_P: Any, k_I: Any, offset: Any, inertia: Any, friction: Any, *more: Any) -> Any:
        """The values stacked by joint; a single row is used for all joints."""
        servo = {"k_P": k_P, "k_I": k_I, "offset": offset, **dict(zip(self._more, more, strict=True))}
        parts = list[Any]()
        for i, used in enumerate(self._used):
            values = [*(servo[name] for name in self.servo), *[inertia] * len(used), *[friction] * len(self.friction)]
            parts += [value[i, :] if getattr(value, "shape", (1, 1))[0] > 1 else value for value in values]
        return ca.vertcat(*parts)
