"""The closed loops in plain NumPy, Pinocchio and SciPy, independent of the framework's equations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import scipy
from numpy.typing import NDArray

from dmframe.graph.graph import Graph
from dmframe.robot.library import find_robot
from dmframe.simulate import Recording, Solver, simulate

Array = NDArray[np.float64]
V_0 = 0.005  # [rad/s] of Coulomb friction


@dataclass
class Robot:
    """A reduced Pinocchio model with joint friction."""

    model: Any
    tool: int
    B: Array
    D: Array
    data: Any = field(init=False)

    def __post_init__(self) -> None:
        self.data = self.model.createData()

    @classmethod
    def load(cls, name: str, tool: str, hold: dict[str, float], B: list[float], D: list[float]) -> Robot:
        full = pin.buildModelFromUrdf(str(find_robot(name).urdf))
        pose = pin.neutral(full)
        for joint, angle in hold.items():
            pose[full.joints[full.getJointId(joint)].idx_q] = angle
        model = pin.buildReducedModel(full, [full.getJointId(joint) for joint in hold], pose)
        return cls(model, model.getFrameId(tool), np.array(B), np.array(D))

    def friction(self, v: Array) -> Array:
        return self.B * v + self.D * np.tanh(v / V_0)

    def acceleration(self, q: Array, dq: Array, torque: Array) -> Array:
        return np.array(pin.aba(self.model, self.data, q, dq, torque - self.friction(dq)))

    def gravity(self, q: Array) -> Array:
        return np.array(pin.computeGeneralizedGravity(self.model, self.data, q))

    def task(self, q: Array, dq: Array) -> tuple[Array, Array, Array]:
        """x, J and its rate."""
        h = 1e-6
        ahead, behind, J = self.jacobian(q + h * dq), self.jacobian(q - h * dq), self.jacobian(q)
        x = self.data.oMf[self.tool].translation.copy()
        return x, J, (ahead - behind) / (2 * h)

    def jacobian(self, q: Array) -> Array:
        pin.computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        return np.array(pin.getFrameJacobian(self.model, self.data, self.tool, pin.LOCAL_WORLD_ALIGNED)[:3])

    def regressor(self, q: Array, dq: Array, v: Array, a: Array) -> Array:
        """M a + C(q, dq) v + g, with polarised products of two velocities."""

        def Y(dq: Array, ddq: Array) -> Array:
            return np.array(pin.computeJointTorqueRegressor(self.model, self.data, q, dq, ddq))

        zero = np.zeros_like(q)
        return Y(zero, a) + (Y(dq + v, zero) - Y(dq, zero) - Y(v, zero) + Y(zero, zero)) / 2


K_D, K_P, K_I = np.array([800.0, 800, 400]), np.array([1760.0, 1760, 880]), np.array([560.0, 560, 280])


@dataclass(frozen=True)
class Experiment:
    """One experiment of Section V, with its path and the paper's gains."""

    T: float
    q_0: tuple[float, float, float]
    center: tuple[float, float, float]
    radius: float
    rate: float
    gamma: float
    K_c: float
    Lambda_PI: float
    w_P: float
    w_I: float

    def path(self, t: float) -> tuple[Array, Array, Array]:
        """x_d with its two derivatives."""
        r, v = self.radius, self.rate
        s, c = r * np.sin(v * t), r * np.cos(v * t)
        return np.add(self.center, [s, c, 0]), v * np.array([c, -s, 0.0]), v * v * np.array([-s, -c, 0.0])


FAST = Experiment(
    0.008, (1.455411, -1.016031, 0.978316), (-0.07, 0.67, 0.55), 0.15, 1.0, 0.8, 0.8, 10.0, w_P=2.0, w_I=0.5
)
SLOW = Experiment(0.09, (2.023732, -1.174227, 1.336627), (-0.45, 0.45, 0.5), 0.1, 0.5, 1.0, 1.5, 0.02, w_P=1.8, w_I=1.2)


def reference(robot: Robot, case: Experiment, t: float, q: Array, dq: Array) -> tuple[Array, Array]:
    """Eq. (30) with known kinematics, and its derivative by hand."""
    gamma, (x_d, dx_d, ddx_d) = case.gamma, case.path(t)
    x, J, dJ = robot.task(q, dq)
    S = np.linalg.inv(J @ J.T)
    dS = -S @ (dJ @ J.T + J @ dJ.T) @ S
    first = J.T @ S @ dx_d - gamma * J.T @ (x - x_d)
    second = dJ.T @ S @ dx_d + J.T @ dS @ dx_d + J.T @ S @ ddx_d - gamma * (dJ.T @ (x - x_d) + J.T @ (J @ dq - dx_d))
    return first, second


Plant = Callable[[Robot, Array, Array, float], Array]


def servo_and_robot(robot: Robot, y: Array, dq_c: Array) -> Array:
    """The rate of (q, dq, q_c, i)."""
    q, dq, q_c, i = y.reshape(4, 3)
    u = -K_D * (dq - dq_c) - K_P * (q - q_c) - K_I * i
    return np.concatenate([dq, robot.acceleration(q, dq, u), dq_c, q - q_c])


def to_rounding(robot: Robot, plant: Array, dq_c: Array, T: float) -> Array:
    """PID servo and robot over one period, the command held."""
    found = scipy.integrate.solve_ivp(
        lambda _, y: servo_and_robot(robot, y, dq_c), (0, T), plant, method="LSODA", rtol=1e-10, atol=1e-12
    )
    return np.array(found.y[:, -1])


def runge_kutta(robot: Robot, plant: Array, dq_c: Array, T: float) -> Array:
    """The same in steps of 2 ms: fast; friction at rest is stiff, so the figures are accurate to some thousandths."""
    count = round(T / 2e-3)
    h = T / count
    for _ in range(count):
        k_1 = servo_and_robot(robot, plant, dq_c)
        k_2 = servo_and_robot(robot, plant + h / 2 * k_1, dq_c)
        k_3 = servo_and_robot(robot, plant + h / 2 * k_2, dq_c)
        k_4 = servo_and_robot(robot, plant + h * k_3, dq_c)
        plant = plant + h / 6 * (k_1 + 2 * k_2 + 2 * k_3 + k_4)
    return plant


@cache
def sampled(case: Experiment, form: str, ticks: int, advance: Plant = to_rounding) -> dict[str, Array]:
    """An experiment by hand: Euler for the controller; `form` is kinematic, or the PID form (32) or (34)."""
    hold = {"wrist_1_joint": 0.0, "wrist_2_joint": -np.pi / 2, "wrist_3_joint": 0.0}
    robot = Robot.load("ur10", "ee_link", hold, [5, 5, 2], [8, 8, 4])
    T, K_c, Lambda, Gamma, q = case.T, case.K_c, 0.01, 1.0, np.array(case.q_0)
    plant = np.concatenate([q, np.zeros(3), q, -robot.gravity(q) / K_I])
    q_r, z, w, w_P, w_I = q.copy(), np.zeros(3), np.zeros(3), np.full(3, case.w_P), np.full(3, case.w_I)
    a = np.zeros(36)
    kept: dict[str, list[Array]] = {name: [] for name in ("x", "x_d", "tau_dc", "w", "w_P", "dq_c")}
    for k in range(ticks + 1):
        q, dq, q_c, _ = plant.reshape(4, 3)
        first, second = reference(robot, case, k * T, q, dq)
        if form == "velocity":  # (32): q_r is the integral of dq_r of the generator, dq_r* = dq_r - K_c (q - q_r)
            dq_r, dq_ref, ddq_ref = first, first - K_c * (q - q_r), second - K_c * (dq - first)
        else:  # (34): dq_r* is the generator's, and q_r is the integral of dq_r* + K_c (q - q_r)
            dq_r, dq_ref, ddq_ref = first + K_c * (q - q_r), first, second
        Y = np.hstack([robot.regressor(q, dq, dq_ref, ddq_ref), np.diag(dq_ref), np.diag(np.tanh(dq_ref / V_0))])
        tau_dc, sigma = Y @ a, dq - dq_ref
        dq_c = first if form == "kinematic" else dq_ref + w_P * (q_r - q_c) + w * tau_dc - w_I * z
        x, x_d = robot.task(q, dq)[0], case.path(k * T)[0]
        for name, value in zip(kept, (x, x_d, tau_dc, w, w_P, dq_c), strict=True):
            kept[name].append(value.copy())
        w, w_P, w_I, z, q_r, a = (
            w - T * Lambda * tau_dc * sigma,
            w_P + T * case.Lambda_PI * (q_c - q_r) * sigma,
            w_I + T * case.Lambda_PI * z * sigma,
            z + T * (q_c - q_r),
            q_r + T * dq_r,
            a - T * Gamma * Y.T @ sigma,
        )
        plant = advance(robot, plant, dq_c, T)
    return {name: np.array(values) for name, values in kept.items()}


TICKS = 200


def run(name: str, method: str) -> Recording:
    graph = Graph.read(name)
    solver = Solver(method=method, step=0.00025, tolerance=1e-11)  # type: ignore[arg-type]
    return simulate(graph.diagram, TICKS * FAST.T, clock=graph.file.clock, solver=solver, start=graph.start)


@pytest.mark.parametrize(("form", "name"), [("velocity", "ur10_fast"), ("position", "ur10_fast_tied_position")])
def test_the_adaptive_loop_on_the_ur10_is_the_one_written_by_hand(form: str, name: str) -> None:
    mine, theirs = sampled(FAST, form, TICKS), run(name, "cvodes")
    assert np.max(np.linalg.norm(mine["x"] - mine["x"][0], axis=1)) > 0.1  # the robot moves
    np.testing.assert_allclose(theirs["arm.x"], mine["x"], atol=2e-9)
    np.testing.assert_allclose(theirs["inverse.dq_c"], mine["dq_c"], atol=2e-7)
    np.testing.assert_allclose(theirs["dynamics.tau_dc"], mine["tau_dc"], atol=1e-7)
    np.testing.assert_allclose(theirs["inverse.w"], mine["w"], atol=1e-9)
    np.testing.assert_allclose(theirs["inverse.w_P"], mine["w_P"], atol=1e-8)


def test_the_two_forms_of_the_pid_law_do_not_move_alike() -> None:
    first, second = (sampled(FAST, form, TICKS) for form in ("velocity", "position"))
    assert np.max(np.abs(first["x"] - second["x"])) > 1e-4


def test_the_kinematic_loop_on_the_ur10_is_the_one_written_by_hand() -> None:
    mine, theirs = sampled(FAST, "kinematic", TICKS), run("ur10_fast_kinematic", "rk4")
    np.testing.assert_allclose(theirs["arm.x"], mine["x"], atol=2e-8)
    np.testing.assert_allclose(theirs["inverse.dq_c"], mine["dq_c"], atol=1e-6)


@pytest.mark.parametrize(
    ("case", "form", "name", "quoted", "seconds"),
    [
        (FAST, "velocity", "ur10_fast", 6.287, 20),
        (FAST, "velocity", "ur10_fast", 6.287, 200),
        (SLOW, "velocity", "ur10_slow", 3.884, 20),
        (SLOW, "position", "ur10_slow_tied_position", 6.428, 20),
    ],
)
def test_the_experiment_has_the_figure_of_the_loop_by_hand(
    case: Experiment, form: str, name: str, quoted: float, seconds: int
) -> None:
    """Over the first tenth, the fast one also over the whole time; the quoted figures are those of 200 s."""
    ticks = round(seconds / case.T)
    mine, graph = sampled(case, form, ticks, runge_kutta), Graph.read(name)
    theirs = simulate(graph.diagram, 200.0, clock=graph.file.clock, solver=graph.solver, start=graph.start)
    error = theirs["arm.x"] - theirs["path.x_d"]
    assert rms(error) == pytest.approx(quoted, rel=0.01)
    assert rms(error[: ticks + 1]) == pytest.approx(rms(mine["x"] - mine["x_d"]), rel=0.01)


def rms(error: Array) -> float:
    """[mm], of the norm, over the last eighth."""
    size = 1e3 * np.linalg.norm(error, axis=1)
    return float(np.sqrt(np.mean(size[-(size.size // 8) :] ** 2)))


GRAPH = """\
dmframe: 1
robot: arm2
clock: continuous
duration: 2 s
solver: {method: cvodes, tolerance: 1e-11, output: 10 ms}
blocks:
  path:     {type: sinusoid, center: [0.8, 1.0], amplitude: [0.5, 0.7], rate: [0.9, 1.4], phase: [0.1, 0.4]}
  task:     {type: joint_tracking, alpha_bar: 2}
  model:    {type: regressor, friction: [viscous]}
  dynamics: {type: dynamic_compensator, Gamma: 30}
  inverse:  {type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w: 0.01, w_I: 2}
  servo:    {type: pi_servo, K_P: [60, 30], K_I: [240, 120]}
  arm:      {type: manipulator, viscous: [1, 0.5], K: [1.2, 0.9]}
"""


def continuous(times: Array) -> Array:
    """Joint tracking with a PI servo as one differential equation; x = (q, dq, ...)."""
    robot = Robot.load("arm2", "tool", {}, [1, 0.5], [0, 0])
    K, K_P, K_I = np.array([1.2, 0.9]), np.array([60.0, 30]), np.array([240.0, 120])
    middle, swing, rate_d, phase = np.array([0.8, 1]), np.array([0.5, 0.7]), np.array([0.9, 1.4]), np.array([0.1, 0.4])

    def field_(t: float, y: Array) -> Array:
        q, dq, q_c, i, q_r, w, w_I = y[:14].reshape(7, 2)
        angle = rate_d * t + phase
        q_d, dq_d = middle + swing * np.sin(angle), swing * rate_d * np.cos(angle)
        dq_ref = dq_d - 2 * (q - q_d)
        ddq_ref = -swing * rate_d**2 * np.sin(angle) - 2 * (dq - dq_d)
        sigma = dq - dq_ref
        Y = np.hstack([robot.regressor(q, dq, dq_ref, ddq_ref), np.diag(dq_ref)])
        tau_dc = Y @ y[14:]
        dq_c = dq_ref + w_I * (q_r - q_c) + w * tau_dc
        u = -K_P * (dq - dq_c) - K_I * i
        rates = [dq, robot.acceleration(q, dq, K * u), dq_c, dq - dq_c, dq_ref]
        rates += [-0.01 * tau_dc * sigma, (q_c - q_r) * sigma, -30 * Y.T @ sigma]
        return np.concatenate(rates)

    q = middle + swing * np.sin(phase)
    start = np.concatenate([q, [0, 0], q, -robot.gravity(q) / (K * K_I), q, [0.01, 0.01], [2, 2], np.zeros(22)])
    found = scipy.integrate.solve_ivp(
        field_, (0, times[-1]), start, method="LSODA", t_eval=times, rtol=1e-11, atol=1e-12
    )
    return np.array(found.y.T)


def test_the_continuous_loop_on_a_planar_arm_is_one_differential_equation_of_scipy(tmp_path: Any) -> None:
    file = tmp_path / "joint.yaml"
    file.write_text(GRAPH)
    graph = Graph.read(file)
    theirs = simulate(graph.diagram, 2.0, solver=graph.solver, start=graph.start)
    mine = continuous(theirs.time)
    np.testing.assert_allclose(theirs["arm.q"], mine[:, 0:2], atol=1e-8)
    np.testing.assert_allclose(theirs["servo.q_c"], mine[:, 4:6], atol=1e-8)
    np.testing.assert_allclose(theirs["servo.i"], mine[:, 6:8], atol=1e-8)
    np.testing.assert_allclose(theirs["inverse.w"], mine[:, 10:12], atol=1e-8)
    np.testing.assert_allclose(theirs["inverse.w_I"], mine[:, 12:14], atol=1e-8)
    assert np.max(np.abs(mine[-1, 14:])) > 0.01  # adaptation is active
