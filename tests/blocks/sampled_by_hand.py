"""The sampled law, its servo and its robot in plain NumPy and Pinocchio, independent of dmframe's equations.

Sample j lasts from j T to (j + 1) T with the held command u_j; v_j is the mean velocity in it. The averaged servo
equation is y_j = u_j - v_j = psi_j' theta, row by row, with unknown constants theta = (k_P, k_I, constant, w a,
w B, w D). An estimator computes theta from positions and commands, and the command of a sample inverts the relation.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]
V_0 = 0.005  # [rad/s] of Coulomb friction, tanh(v / V_0)


@dataclass(frozen=True)
class Circle:
    """The path, in the plane of the first two axes."""

    center: tuple[float, float, float]
    radius: float
    rate: float

    def __call__(self, t: float) -> Array:
        return self.center + self.radius * np.array([np.sin(self.rate * t), np.cos(self.rate * t), 0])

    def velocity(self, t: float) -> Array:
        return self.rate * self.radius * np.array([np.cos(self.rate * t), -np.sin(self.rate * t), 0])


@dataclass
class Arm:
    """A Pinocchio model of revolute joints with friction, and the regressors of its 10 n inertial parameters."""

    model: Any
    tool: int
    B: Array
    D: Array
    data: Any = field(init=False)

    def __post_init__(self) -> None:
        self.data = self.model.createData()

    @classmethod
    def load(cls, urdf: str, tool: str, hold: dict[str, float], B: list[float], D: list[float]) -> Arm:
        full = pin.buildModelFromUrdf(urdf)
        pose = pin.neutral(full)
        for joint, angle in hold.items():
            pose[full.joints[full.getJointId(joint)].idx_q] = angle
        model = pin.buildReducedModel(full, [full.getJointId(joint) for joint in hold], pose)
        return cls(model, model.getFrameId(tool), np.array(B), np.array(D))

    def acceleration(self, q: Array, dq: Array, torque: Array) -> Array:
        return np.array(pin.aba(self.model, self.data, q, dq, torque - self.B * dq - self.D * np.tanh(dq / V_0)))

    def gravity_torque(self, q: Array) -> Array:
        return np.array(pin.computeGeneralizedGravity(self.model, self.data, q))

    def position(self, q: Array) -> Array:
        pin.forwardKinematics(self.model, self.data, q)
        return np.array(pin.updateFramePlacement(self.model, self.data, self.tool).translation)

    def jacobian(self, q: Array) -> Array:
        J = pin.computeFrameJacobian(self.model, self.data, q, self.tool, pin.LOCAL_WORLD_ALIGNED)
        return np.array(J[:3])

    def gravity(self, q: Array) -> Array:
        """Y_g of Y_g a = g(q)."""
        still = np.zeros_like(q)
        return np.array(pin.computeJointTorqueRegressor(self.model, self.data, q, still, still))

    def momentum(self, q: Array, v: Array) -> Array:
        """Y_p of Y_p a = M(q) v."""
        still = np.zeros_like(q)
        return np.array(pin.computeJointTorqueRegressor(self.model, self.data, q, still, v)) - self.gravity(q)

    def slope_of_energy(self, q: Array, v: Array) -> Array:
        """Y_c of Y_c a = d/dq (v' M(q) v / 2) = C'v.

        In each angle the energy has harmonics up to the second, so two central differences give its slope exactly.
        """
        rows = np.empty((q.size, 10 * q.size))
        for joint, row in enumerate(rows):
            e = np.eye(q.size)[joint]
            wide = self._energy(q + np.pi / 2 * e, v) - self._energy(q - np.pi / 2 * e, v)
            near = self._energy(q + np.pi / 4 * e, v) - self._energy(q - np.pi / 4 * e, v)
            row[:] = near + (1 - np.sqrt(2)) / 2 * wide
        return rows

    def _energy(self, q: Array, v: Array) -> Array:
        return np.array(pin.computeKineticEnergyRegressor(self.model, self.data, q, v))


@dataclass
class Plant:
    """Robot and manufacturer's servo, at rest at first, its integrator compensating gravity; RK4 steps of `step`.

    PID: u = -K_D (dq - dq_c) - K_P (q - q_c) - K_I int (q - q_c); PI: K_I = 0, and q_c with K_P compensates gravity.
    """

    arm: Arm
    q: Array
    K_D: Array
    K_P: Array
    K_I: Array
    offset: float | Array = 0.0  # [rad] offset of the servo's q_c(0) from the q(0) that the law assumes
    step: float = 1e-3
    state: Array = field(init=False)

    def __post_init__(self) -> None:
        g, still = self.arm.gravity_torque(self.q), np.zeros_like(self.q)
        pid = np.all(self.K_I > 0)
        i = -g / self.K_I if pid else still
        q_c = self.q if pid else self.q + g / self.K_P
        self.state = np.array([self.q, still, q_c + self.offset, i])

    def advance(self, dq_c: Array, T: float) -> Array:
        """q after a sample of the command dq_c."""
        count = round(T / self.step)
        h = T / count
        for _ in range(count):
            k_1 = self._rate(self.state, dq_c)
            k_2 = self._rate(self.state + h / 2 * k_1, dq_c)
            k_3 = self._rate(self.state + h / 2 * k_2, dq_c)
            k_4 = self._rate(self.state + h * k_3, dq_c)
            self.state = self.state + h / 6 * (k_1 + 2 * k_2 + 2 * k_3 + k_4)
        return self.state[0].copy()

    def _rate(self, state: Array, dq_c: Array) -> Array:
        q, dq, q_c, i = state
        torque = -self.K_D * (dq - dq_c) - self.K_P * (q - q_c) - self.K_I * i
        return np.array([dq, self.arm.acceleration(q, dq, torque), dq_c, q - q_c])


@dataclass(frozen=True)
class Known:
    """The law's data at a sampling instant: the present state; psi and y of the last sample, filtered, h and g."""

    q: Array
    c: Array  # own target position
    z: Array  # integral of q - c
    m: Array  # the last sample's middle
    v: Array  # and mean velocity
    psi: Array
    y: Array
    h: Array
    g: Array


@dataclass
class SampledLaw:
    """Estimator and command. `w_0` [rad/(N m s)], for all joints or each, is 1/(K K_D) within a factor of ten."""

    arm: Arm
    T: float
    w_0: float | Array = 1 / 800
    tau: float | None = 2.0  # [s] of the filter; None: unfiltered
    stored: int = 20  # W
    average: int = 1  # L, number of rows over which the mean is estimated: several with fast clocks
    stride: int = 1  # the ring stores the mean of every so many samples
    nu: float = 1e-5
    delay: int = 0
    pid: bool = True
    gamma: float = 1.0
    Lambda: float | None = None  # [1/s] of the error fed back through the Jacobian's inverse, instead of gamma
    damping: float = 0.0  # [m] of the Jacobian's inverse
    u_max: float = 3.0
    margin: float = 0.05  # mu of the guard
    start: tuple[float, float] = (1.8, 1.2)  # of k_P and k_I
    known: Known = field(init=False)
    theta: Array = field(init=False)
    guarded: int = 0

    def begin(self, q: Array) -> None:
        """A standstill before the first sample, for which the constant of the servo compensates gravity."""
        n, zero = q.size, np.zeros_like(q)
        servo = 2 if self.pid else 1
        links, friction = 10 * n, 2
        self.constant = servo
        w_0 = np.broadcast_to(self.w_0, n)[:, None]

        def columns(gains: list[float], constant: Array, inertia: Array, rubbing: Array) -> Array:
            parts = np.tile(gains[:servo], (n, 1)), constant, np.tile(inertia, links), np.tile(rubbing, friction)
            return np.hstack(parts)

        size = columns([1, 1], 30 * w_0, 5 * w_0, 5 * w_0)
        self.Gamma = size**2
        self.lower = columns([0.2, 0.05], 0 * w_0 - 1, -20 * w_0, 0 * w_0)
        self.upper = columns([6.0, 4.0], 0 * w_0 + 1, 20 * w_0, 50 * w_0)
        self.theta = np.zeros_like(size)
        self.theta[:, :servo] = self.start[:servo]
        self.ring: list[tuple[Array, Array, Array]] = []  # rows, excess of commands, adapting joints
        self.recent: list[tuple[Array, Array, Array]] = []
        self.learnt = 0
        self.sent = [zero] * self.delay  # commands of the samples to come
        self.plan = (q, zero)  # the last command's planned middle and velocity
        self.planned = [zero] * self.delay  # velocities for which the sent commands were computed
        psi = self._columns(zero, zero, self.arm.gravity(q), zero)
        h = np.zeros_like(psi)
        h[:, self.constant] = 1
        self.known = Known(q, q, zero, q, zero, psi, zero, psi if self.tau is None else h, zero)

    def _columns(self, e: Array, z: Array, inertial: Array, v: Array) -> Array:
        servo = [e, z, np.ones_like(e)] if self.pid else [e, np.ones_like(e)]
        return np.column_stack([*servo, inertial, v, np.tanh(v / V_0)])

    def row(self, at: Known, u: Array, v: Array, before: tuple[Array, Array] | None) -> Array:
        """psi of a sample from `at` with command u and mean velocity v; momentum counted from `before`, None: not."""
        m = at.q + self.T * v / 2
        e = m - at.c - self.T * u / 2
        inertial = self.arm.gravity(m) - self.arm.slope_of_energy(m, v)
        if before is not None:
            inertial += (self.arm.momentum(m, v) - self.arm.momentum(*before)) / self.T
        return self._columns(e, at.z + self.T * e / 2, inertial, v)

    def after(self, at: Known, u: Array, q: Array) -> Known:
        """The data at the next sampling instant, with the robot at q."""
        v, m = (q - at.q) / self.T, (q + at.q) / 2
        psi, y = self.row(at, u, v, (at.m, at.v)), u - v
        h, g = psi, y
        if self.tau is not None:
            keep = 1 - self.T / self.tau
            h, g = psi - at.psi + keep * at.h, y - at.y + keep * at.g
            h[:, self.constant] = 1
        z = at.z + self.T * (m - at.c - self.T * u / 2)
        return Known(q, at.c + self.T * u, z, m, v, psi, y, h, g)

    def excess(self, at: Known, u: Array, v: Array, before: tuple[Array, Array] | None) -> Array:
        """u - v predicted with theta: F(v) - v. Filtered, the prediction starts from the state of the filters."""
        found = np.sum(self.row(at, u, v, before) * self.theta, axis=1)
        if self.tau is None:
            return found
        keep, others = 1 - self.T / self.tau, self.theta.copy()
        others[:, self.constant] = 0
        return np.array(found + at.y - keep * at.g - np.sum((at.psi - keep * at.h) * others, axis=1))

    def learn(self, h: Array, g: Array, free: Array) -> None:
        """Projection onto the newest row, the stored rows from new to old, the newest again; none if u was clipped."""
        self.recent = [(h, g, free), *self.recent][: self.average]
        rows, excesses, frees = zip(*self.recent, strict=True)
        newest = (np.mean(rows, axis=0), np.mean(excesses, axis=0), np.all(frees, axis=0))
        for row, excess, learns in [newest, *self.ring, newest]:
            error = excess - np.sum(row * self.theta, axis=1)
            size = self.nu + np.sum(row**2 * self.Gamma, axis=1)
            step = self.Gamma * row * (error / size)[:, None]
            self.theta = np.clip(self.theta + learns[:, None] * step, self.lower, self.upper)
        self.learnt += 1
        if self.learnt % self.stride == 0:
            self.ring = [newest, *self.ring][: self.stored]

    def inertia(self, q: Array) -> Array:
        """S = w M / T as estimated."""
        links = self.theta[:, self.constant + 1 : -2]
        columns = [np.sum(self.arm.momentum(q, e) * links, axis=1) for e in np.eye(q.size)]
        return np.column_stack(columns) / self.T

    def slope(self) -> Array:
        """Sensitivity of e to u in F(v_des), 1 + T k_P / 2 + T^2 k_I / 4."""
        T = self.T
        return np.array(1 + T * self.theta[:, 0] / 2 + (T * T * self.theta[:, 1] / 4 if self.pid else 0))

    def predict(self, at: Known, u: Array, v: Array) -> Array:
        """The mean velocity for a command that was computed for v: F(v) = u by four damped Newton steps."""
        S = self.inertia(at.q)
        for _ in range(4):
            wrong = u - v - self.excess(at, u, v, (at.m, at.v))
            friction = self.theta[:, -2] + self.theta[:, -1] / V_0  # at rest, where it is steepest
            v = v + np.linalg.solve(np.diag(self.slope() + friction) + S, wrong)
        return v

    def goal(self, q: Array, x_d: Array, next_x_d: Array) -> Array:
        """Mean velocity that reaches the path's next point, except for the remaining error."""
        T, v, J = self.T, np.zeros_like(q), self.arm.jacobian(q)
        error = self.arm.position(q) - x_d
        target = next_x_d + error - T * (self.gamma * J @ J.T @ error if self.Lambda is None else self.Lambda * error)
        for _ in range(2):
            J = self.arm.jacobian(q + T * v)
            missing = (target - self.arm.position(q + T * v)) / T
            v = v + J.T @ np.linalg.solve(J @ J.T + self.damping**2 * np.eye(3), missing)
        return v

    def command(self, at: Known, v: Array) -> Array:
        """u with F(v) = u; momentum differences between plans are omitted if the estimated inertia is not safe."""
        S = self.inertia(at.q)
        safe = np.linalg.eigvalsh((S + S.T) / 2)[0] >= -0.5 + self.margin and np.linalg.norm(S) <= 4
        self.guarded += not safe
        u = (v + self.excess(at, np.zeros_like(v), v, self.plan if safe else None)) / self.slope()
        self.plan = (at.q + self.T * v / 2, v)
        return np.clip(u, -self.u_max, self.u_max)

    def tick(self, k: int, q: Array, path: Circle) -> Array:
        """The command of sample k, computed `delay` samples before: measure, estimate, predict, plan."""
        if k > 0:
            u = self.sent.pop(0)
            self.planned.pop(0)
            self.known = self.after(self.known, u, q)
            self.learn(self.known.h, self.known.g, np.abs(u) < self.u_max)
        ahead = self.known
        for u, v in zip(self.sent, self.planned, strict=True):
            ahead = self.after(ahead, u, ahead.q + self.T * self.predict(ahead, u, v))
        t = (k + self.delay) * self.T
        self.v_des = self.goal(ahead.q, path(t), path(t + self.T))
        self.sent.append(self.command(ahead, self.v_des))
        self.planned.append(self.v_des)
        return self.sent[0]


@dataclass
class LeastSquaresLaw(SampledLaw):
    """theta minimises (x - theta)' W (x - theta) + (g - h' x)^2 / nu; W is the weight of the past, partly forgotten.

    An element that leaves its box changes the others to the minimum on its face; elements that are still outside are
    clipped, and the weight of the past is reset.
    """

    retention: float = 0.98
    heaviest: float = 20.0  # [kg m^2] and so on, at most
    faces: int = 0
    cuts: int = 0

    def begin(self, q: Array) -> None:
        super().begin(q)
        links = slice(self.constant + 1, -2)
        w_0 = np.broadcast_to(self.w_0, q.size)[:, None]
        self.lower[:, links], self.upper[:, links] = -self.heaviest * w_0, self.heaviest * w_0
        self.W = np.array([np.diag(1 / sizes) for sizes in self.Gamma])

    def learn(self, h: Array, g: Array, free: Array) -> None:
        self.recent = [(h * free[:, None], g * free, free), *self.recent][: self.average]
        rows, excesses = (np.mean([item[k] for item in self.recent], axis=0) for k in (0, 1))
        for joint, (row, excess) in enumerate(zip(rows, excesses, strict=True)):
            old, first = self.W[joint], np.diag(1 / self.Gamma[joint])
            lower, upper = self.lower[joint], self.upper[joint]
            W = old + np.outer(row, row) / self.nu
            x = np.linalg.solve(W, old @ self.theta[joint] + row * excess / self.nu)
            for i in range(x.size):
                end = np.clip(x[i], lower[i], upper[i])
                if x[i] != end:
                    others = np.arange(x.size) != i
                    x[others] += np.linalg.solve(W[np.ix_(others, others)], W[others, i] * (x[i] - end))
                    x[i] = end
                    self.faces += 1
            self.theta[joint] = np.clip(x, lower, upper)
            if np.any(self.theta[joint] != x):
                W = first
                self.cuts += 1
            self.W[joint] = self.retention * W + (1 - self.retention) * first


@dataclass
class Observer(SampledLaw):
    """Special case of one column, the constant, with nu = 0: the excess of the last sample is that of the next."""

    def learn(self, h: Array, g: Array, free: Array) -> None:
        self.theta = np.where(free, self.known.y, self.theta[:, 0])[:, None]

    def begin(self, q: Array) -> None:
        super().begin(q)
        self.theta = np.zeros((q.size, 1))

    def predict(self, at: Known, u: Array, v: Array) -> Array:
        return np.array(u - self.theta[:, 0])

    def command(self, at: Known, v: Array) -> Array:
        return np.clip(v + self.theta[:, 0], -self.u_max, self.u_max)


@dataclass
class Kinematic(SampledLaw):
    """The baseline: J^-1 dx_d - gamma J' (x - x_d), commanded directly and without delay compensation."""

    def tick(self, k: int, q: Array, path: Circle) -> Array:
        J, error = self.arm.jacobian(q), self.arm.position(q) - path(k * self.T)
        self.v_des = np.linalg.solve(J, path.velocity(k * self.T)) - self.gamma * J.T @ error
        self.sent.append(self.v_des)
        return self.sent.pop(0)


def closed_loop(law: SampledLaw, plant: Plant, path: Circle, ticks: int, encoder: float = 0.0) -> dict[str, Array]:
    """Signals at every sampling instant: q, x - x_d, the u applied from then on, v_des, and the new theta."""
    seen: dict[str, list[Array]] = {name: [] for name in ("q", "error", "u", "v_des", "theta")}
    q = plant.q
    for k in range(ticks):
        measured = np.round(q / encoder) * encoder if encoder else q
        if k == 0:
            law.begin(measured)
        u = law.tick(k, measured, path)
        values = (q, law.arm.position(q) - path(k * law.T), u, law.v_des, law.theta)
        for name, value in zip(seen, values, strict=True):
            seen[name].append(value.copy())
        q = plant.advance(u, law.T)
    return {name: np.array(values) for name, values in seen.items()}


def rms(error: Array) -> float:
    """[mm], of the norm, over the last eighth."""
    size = 1e3 * np.linalg.norm(error, axis=1)
    return float(np.sqrt(np.mean(size[-(size.size // 8) :] ** 2)))
