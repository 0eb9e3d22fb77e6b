"""The closed loops once more in plain NumPy, Pinocchio and SciPy, sharing no equation with the framework."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from dmframe.config.graph import load_graph
from dmframe.robot.library import find_robot
from dmframe.simulate import Run, Solver, simulate

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
        """Of M a + C(q, dq) v + g, the products of two velocities polarised."""

        def Y(dq: Array, ddq: Array) -> Array:
            return np.array(pin.computeJointTorqueRegressor(self.model, self.data, q, dq, ddq))

        zero = np.zeros_like(q)
        return Y(zero, a) + (Y(dq + v, zero) - Y(dq, zero) - Y(v, zero) + Y(zero, zero)) / 2


def circle(t: float) -> tuple[Array, Array, Array]:
    """The path of the fast experiment with its two derivatives."""
    s, c = 0.15 * np.sin(t), 0.15 * np.cos(t)
    return np.array([-0.07 + s, 0.67 + c, 0.55]), np.array([c, -s, 0.0]), np.array([-s, -c, 0.0])


def reference(robot: Robot, t: float, q: Array, dq: Array) -> tuple[Array, Array]:
    """dq_ref of eq. (30) with known kinematics, and its derivative by hand."""
    gamma, (x_d, dx_d, ddx_d) = 0.8, circle(t)
    x, J, dJ = robot.task(q, dq)
    S = np.linalg.inv(J @ J.T)
    dS = -S @ (dJ @ J.T + J @ dJ.T) @ S
    dq_ref = J.T @ S @ dx_d - gamma * J.T @ (x - x_d)
    ddq_ref = dJ.T @ S @ dx_d + J.T @ dS @ dx_d + J.T @ S @ ddx_d - gamma * (dJ.T @ (x - x_d) + J.T @ (J @ dq - dx_d))
    return dq_ref, ddq_ref


K_D, K_P, K_I = np.array([800.0, 800, 400]), np.array([1760.0, 1760, 880]), np.array([560.0, 560, 280])
START = np.array([1.455411, -1.016031, 0.978316])
T, TICKS = 0.008, 200


def advance(robot: Robot, plant: Array, dq_c: Array) -> Array:
    """PID servo and robot over one period, the command held."""

    def rate(_: float, y: Array) -> Array:
        q, dq, q_c, i = np.split(y, 4)
        u = -K_D * (dq - dq_c) - K_P * (q - q_c) - K_I * i
        return np.concatenate([dq, robot.acceleration(q, dq, u), dq_c, q - q_c])

    return np.array(solve_ivp(rate, (0, T), plant, method="LSODA", rtol=1e-10, atol=1e-12).y[:, -1])


def sampled(adaptive: bool) -> dict[str, Array]:
    """The fast experiment, by hand: Euler for the controller, an adaptive integrator for the plant."""
    hold = {"wrist_1_joint": 0.0, "wrist_2_joint": -np.pi / 2, "wrist_3_joint": 0.0}
    robot = Robot.load("ur10", "ee_link", hold, [5, 5, 2], [8, 8, 4])
    q, K_c, Lambda, Lambda_P, Lambda_I, Gamma = START, 0.8, 0.01, 10.0, 10.0, 1.0
    plant = np.concatenate([q, np.zeros(3), q, -robot.gravity(q) / K_I])
    q_r, z, w, w_P, w_I, a = q.copy(), np.zeros(3), np.zeros(3), np.full(3, 2.0), np.full(3, 0.5), np.zeros(36)
    kept: dict[str, list[Array]] = {"x": [], "tau_dc": [], "w": [], "w_P": [], "dq_c": []}
    for k in range(TICKS + 1):
        q, dq, q_c, _ = np.split(plant, 4)
        dq_ref, ddq_ref = reference(robot, k * T, q, dq)
        Y = np.hstack([robot.regressor(q, dq, dq_ref, ddq_ref), np.diag(dq_ref), np.diag(np.tanh(dq_ref / V_0))])
        tau_dc, sigma = Y @ a, dq - dq_ref
        dq_c = dq_ref + w_P * (q_r - q_c) + w * tau_dc - w_I * z if adaptive else dq_ref
        for name, value in (("x", robot.task(q, dq)[0]), ("tau_dc", tau_dc), ("w", w), ("w_P", w_P), ("dq_c", dq_c)):
            kept[name].append(value.copy())
        w, w_P, w_I, z, q_r, a = (
            w - T * Lambda * tau_dc * sigma,
            w_P + T * Lambda_P * (q_c - q_r) * sigma,
            w_I + T * Lambda_I * z * sigma,
            z + T * (q_c - q_r),
            q_r + T * (dq_ref + K_c * (q - q_r)),
            a - T * Gamma * Y.T @ sigma,
        )
        plant = advance(robot, plant, dq_c)
    return {name: np.array(values) for name, values in kept.items()}


def run(name: str, method: str) -> Run:
    graph = load_graph(name)
    solver = Solver(method=method, step=0.00025, tolerance=1e-11)  # type: ignore[arg-type]
    return simulate(graph.diagram(), TICKS * T, clock=graph.file.clock, solver=solver, start=graph.start)


def test_the_adaptive_loop_on_the_ur10_is_the_one_written_by_hand() -> None:
    mine, theirs = sampled(adaptive=True), run("ur10_fast", "cvodes")
    assert np.max(np.linalg.norm(mine["x"] - mine["x"][0], axis=1)) > 0.1  # it does move
    np.testing.assert_allclose(theirs["arm.x"], mine["x"], atol=2e-9)
    np.testing.assert_allclose(theirs["inverse.dq_c"], mine["dq_c"], atol=2e-7)
    np.testing.assert_allclose(theirs["dynamics.tau_dc"], mine["tau_dc"], atol=1e-7)
    np.testing.assert_allclose(theirs["inverse.w"], mine["w"], atol=1e-9)
    np.testing.assert_allclose(theirs["inverse.w_P"], mine["w_P"], atol=1e-8)


def test_the_kinematic_loop_on_the_ur10_is_the_one_written_by_hand() -> None:
    mine, theirs = sampled(adaptive=False), run("ur10_fast_kinematic", "rk4")
    np.testing.assert_allclose(theirs["arm.x"], mine["x"], atol=2e-8)
    np.testing.assert_allclose(theirs["inverse.dq_c"], mine["dq_c"], atol=1e-6)


GRAPH = """\
dmframe: 1
robot: arm2
clock: continuous
duration: 2 s
solver: {method: cvodes, tolerance: 1e-11, output: 10 ms}
blocks:
  path:     {type: sinusoid, center: [0.8, 1.0], amplitude: [0.5, 0.7], rate: [0.9, 1.4], phase: [0.1, 0.4]}
  task:     {type: joint_tracking, alpha: 2}
  model:    {type: regressor, friction: [viscous]}
  dynamics: {type: dynamic_compensator, Gamma: 30}
  inverse:  {type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w: 0.01, w_I: 2}
  servo:    {type: pi_servo, K_P: [60, 30], K_I: [240, 120]}
  arm:      {type: manipulator, viscous: [1, 0.5], K: [1.2, 0.9]}
"""


def continuous(times: Array) -> Array:
    """Tracking at the joints through a PI servo, all of it one differential equation; x = (q, dq, ...)."""
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
    found = solve_ivp(field_, (0, times[-1]), start, method="LSODA", t_eval=times, rtol=1e-11, atol=1e-12)
    return np.array(found.y.T)


def test_the_continuous_loop_on_a_planar_arm_is_one_differential_equation_of_scipy(tmp_path: Any) -> None:
    file = tmp_path / "joint.yaml"
    file.write_text(GRAPH)
    graph = load_graph(file)
    theirs = simulate(graph.diagram(), 2.0, solver=graph.solver, start=graph.start)
    mine = continuous(theirs.time)
    np.testing.assert_allclose(theirs["arm.q"], mine[:, 0:2], atol=1e-8)
    np.testing.assert_allclose(theirs["servo.q_c"], mine[:, 4:6], atol=1e-8)
    np.testing.assert_allclose(theirs["servo.i"], mine[:, 6:8], atol=1e-8)
    np.testing.assert_allclose(theirs["inverse.w"], mine[:, 10:12], atol=1e-8)
    np.testing.assert_allclose(theirs["inverse.w_I"], mine[:, 12:14], atol=1e-8)
    assert np.max(np.abs(mine[-1, 14:])) > 0.01  # it does adapt
