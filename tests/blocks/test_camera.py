"""A fixed uncalibrated camera: its image, the law, the identity of its proof, and the packaged loop."""

from __future__ import annotations

import re
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
import scipy
from closed_robot import ClosedRobot

import dmframe as dm
from dmframe.analysis import linearise, linearised_period, prove_stability
from dmframe.catalogue import find_block
from dmframe.graph.graph import Graph
from dmframe.results.metrics import tracking_error
from dmframe.results.plotting import coordinate_labels
from dmframe.simulate import Solver, simulate
from dmframe_blocks import adaptive_camera
from dmframe_blocks._image import image_regressor

Array = np.ndarray

POSITION = np.array([0.7, 1.9, 0.9])
RIGHT, DOWN, AHEAD = np.array([[-0.842, 0.540, 0], [0.146, 0.227, -0.963], [-0.520, -0.810, -0.270]])
A_C = np.concatenate([RIGHT, DOWN, AHEAD])
GUESS = np.array([-1.01, 0.43, 0, 0.175, 0.18, -1.155, -0.416, -0.97, -0.216])
GOAL = np.array([0.01, 0.03])


def seen(x: Array) -> tuple[Array, float]:
    """The image and the depth by one 3 x 4 projection matrix."""
    rows = np.stack([RIGHT, DOWN, AHEAD])
    u, v, z = np.column_stack([rows, -rows @ POSITION]) @ [*x, 1]
    return np.array([u / z, v / z]), z


def motion(a_c: Array, chi: Array, e: Array) -> Array:
    """G = N - (chi - e/2) ahead'."""
    N, ahead = a_c[:6].reshape(2, 3), a_c[6:]
    return np.array(N - np.outer(chi - e / 2, ahead))


def test_the_camera_is_a_projection_matrix_and_warns_of_a_tool_that_comes_near() -> None:
    given = {"position": POSITION.tolist(), "right": RIGHT.tolist(), "down": DOWN.tolist(), "ahead": AHEAD.tolist()}
    camera = find_block("camera")(**given, depth_min=0.5)
    for x, lacking in (([-0.1, 0.7, 0.5], 0), ((POSITION + 0.4 * AHEAD / (AHEAD @ AHEAD)).tolist(), 0.1)):
        found, (chi, z) = camera.evaluate({"x": x}).outputs, seen(np.array(x))
        np.testing.assert_allclose(found["chi"], chi, atol=1e-14)
        assert found["depth"] == pytest.approx(z)
        assert found["lacking"] == pytest.approx(lacking, abs=1e-14)
        np.testing.assert_array_equal(found["a_c"], A_C)


def test_the_laws_are_those_of_the_page() -> None:
    rng = np.random.default_rng(0)
    chi, chi_d, dq, y = rng.normal(size=2), rng.normal(size=2), rng.normal(size=4), rng.normal(size=4)
    J, e = rng.normal(size=(3, 4)), chi - chi_d
    image = find_block("adaptive_camera")(Gamma_c=2, a_c_hat=GUESS.tolist())
    learnt = image.evaluate({"dq": dq, "J_hat": J, "chi": chi, "e_chi": e}, {"a_c_hat": GUESS})
    J_chi = motion(GUESS, chi, e) @ J
    np.testing.assert_allclose(learnt.outputs["J_chi"], J_chi, atol=1e-13)
    h, slopes = 1e-6, []
    for axis in np.eye(9):
        slopes.append(e @ (motion(GUESS + h * axis, chi, e) - motion(GUESS - h * axis, chi, e)) @ J @ dq / (2 * h))
    np.testing.assert_allclose(learnt.rates["a_c_hat"], 2 * np.array(slopes), atol=1e-8)
    task = find_block("image_regulation")(K_1=3, K_2=[1, 2, 3, 4], alpha=5)
    found = task.evaluate({"chi": chi, "chi_d": chi_d, "J_chi": J_chi}, {"y": y})
    np.testing.assert_allclose(found.outputs["dq_r"], -np.array([1, 2, 3, 4]) * y)
    np.testing.assert_allclose(found.outputs["tau_task"], -5 * J_chi.T @ e)
    np.testing.assert_allclose(found.outputs["e_chi"], e)
    np.testing.assert_allclose(found.rates["y"], 3 * (J_chi.T @ e - y))


def test_along_a_swing_of_pinocchios_robot_the_weighed_error_moves_as_stated_by_the_regressor() -> None:
    """The UR10 falls from rest; half of z |e|^2 by central differences, compared with e' Y_c a_c."""
    model = dm.load("ur10_camera").diagram.robot.model
    data, tool = model.createData(), model.getFrameId("ee_link")

    def place(q: Array) -> tuple[Array, Array]:
        J = pin.computeFrameJacobian(model, data, q, tool, pin.LOCAL_WORLD_ALIGNED)[:3]
        pin.framesForwardKinematics(model, data, q)
        return data.oMf[tool].translation.copy(), J

    def weighed(q: Array) -> float:
        chi, z = seen(place(q)[0])
        return float(z * (chi - GOAL) @ (chi - GOAL) / 2)

    def rate(_: float, s: Array) -> Array:
        return np.concatenate([s[3:], pin.aba(model, data, s[:3], s[3:], np.array([20.0, 0, 0]))])

    times = np.arange(0, 0.5, 1e-3)
    begin = np.concatenate([[1.455411, -1.016031, 0.978316], np.zeros(3)])
    states = scipy.integrate.solve_ivp(rate, (0, 0.5), begin, t_eval=times, rtol=1e-11, atol=1e-12).y.T
    differences = np.gradient([weighed(s[:3]) for s in states], times, edge_order=2)[1:-1]
    right, halfless = [], []
    for s in states[1:-1]:
        x, J = place(s[:3])
        chi, e = seen(x)[0], seen(x)[0] - GOAL
        Y_c = image_regressor(ca.DM(chi), ca.DM(e), ca.DM(J @ s[3:])).full()
        right.append(e @ Y_c @ A_C)
        halfless.append(e @ motion(A_C, chi, 0 * e) @ J @ s[3:])
    scale = np.max(np.abs(differences))
    assert np.max(np.abs(differences - right)) < 1e-4 * scale
    assert np.max(np.abs(differences - halfless)) > 1e-2 * scale, "the depth that moves makes a half"


PI = """
  inverse: {type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w_I: 1, w_box: [0, 0.004], w_I_box: [0.2, 10]}
  servo:   {type: pi_servo, K_P: [800, 800, 400], K_I: [1760, 1760, 880]}
"""


def with_pi_servo() -> Graph:
    text = dm.load("ur10_camera").text.partition("baseline:")[0]
    text, count = re.subn(r"(?m)^  (inverse|servo):.*\n", "", text)
    assert count == 2
    return dm.load(text + PI[1:])


@pytest.mark.parametrize("graph", [lambda: dm.load("ur10_camera"), with_pi_servo], ids=["PID", "PI"])
def test_it_is_proved_up_to_the_depth_and_the_error_in_the_image_goes_to_zero(graph: Any) -> None:
    verdict = graph().verify().verdict
    assert verdict.outcome == "proved"
    assert len(verdict.controls) >= 24
    assert all(control.refuted for control in verdict.controls)
    texts = [item.text for item in verdict.assumptions]
    assert any(
        text.startswith("task: the weight alpha depth of |chi - chi_d|^2 in V stays above a positive constant")
        and text.endswith("the tool stays in front of the camera")
        for text in texts
    )
    assert any(text.startswith("J_chi (image) keeps full row rank") for text in texts)
    assert not any("uses exact values of" in text and "camera" in text for text in texts), "the camera is not known"
    concluded = {item.signal for item in verdict.statements if item.concludes}
    assert {"chi - chi_d", "d(chi - chi_d)/dt"} <= concluded


@pytest.mark.parametrize(
    "wrong",
    [lambda chi, e, dx: image_regressor(chi, 0 * e, dx), lambda chi, e, dx: -image_regressor(chi, e, dx)],
    ids=["not half way", "wrong sign"],
)
def test_a_law_with_another_regressor_is_not_what_the_block_claims(monkeypatch: pytest.MonkeyPatch, wrong: Any) -> None:
    monkeypatch.setattr(adaptive_camera, "image_regressor", wrong)
    verdict = dm.load("ur10_camera").verify().verdict
    assert verdict.outcome == "refuted", verdict.reason


def test_with_the_tool_behind_the_camera_nothing_is_proved() -> None:
    turned = dm.load("ur10_camera").set({"camera.ahead": (-AHEAD).tolist()})
    verdict = turned.verify().verdict
    assert verdict.outcome == "not_applicable"
    assert "the weight alpha depth of |chi - chi_d|^2 in V is above zero at the start" in verdict.reason


def test_an_error_of_6_hundredths_goes_below_1e_5_with_a_camera_that_is_20_percent_wrong() -> None:
    there = A_C != 0
    np.testing.assert_allclose(np.abs(GUESS[there] / A_C[there] - 1), 0.2, atol=0.01)
    run = dm.load("ur10_camera").run()
    error = np.linalg.norm(run["task.e_chi"], axis=1)
    assert 0.05 < error[0] < 0.06
    assert np.max(error[run.time > 9.9]) < 1e-5
    assert np.min(run["camera.depth"]) > 1.3
    assert np.max(np.abs(run["image.a_c_hat"][-1] - A_C)) > 0.05, "the camera itself need not be found"
    assert [text for text in run.notices if not text.startswith("V rose by")] == []
    tracking = tracking_error(run.recording)
    assert tracking is not None
    assert (tracking.signal, tracking.unit) == ("chi - chi_d", "")
    np.testing.assert_allclose(tracking.norm, error)
    assert coordinate_labels(run.recording, tracking) == [("χ, 1:\nerror", "1", 1.0), ("χ, 2:\nerror", "1", 1.0)]


def test_a_tool_that_comes_nearer_than_the_configured_depth_gives_a_notice() -> None:
    run = dm.load("ur10_camera").set({"camera.depth_min": 1.34}).run(until=2.0)
    assert any("the tool is nearer to the camera than depth_min" in notice for notice in run.notices)


K_D = np.array([800.0, 800, 400])
K_P, K_I = 2.2 * K_D, 0.7 * K_D
VISCOUS, COULOMB, ROTOR = np.array([19.7, 16.8, 8.9]), np.array([13.6, 14.9, 5.8]), np.array([2.5, 4.7, 1.2])
K_1, K_2, ALPHA, GAMMA_C, GAMMA, K_C, T = 10, 8, 1000, 1.0, 10.0, 0.7, 0.008


class ByHand:
    """`ur10_camera` in NumPy and Pinocchio: camera, reference, adaptive laws, servo and robot."""

    def __init__(self, experiment: Graph) -> None:
        self.model = experiment.diagram.robot.model.copy()
        self.data, self.tool = self.model.createData(), self.model.getFrameId("ee_link")
        self.robot = ClosedRobot(self.model, VISCOUS, COULOMB, K_D, K_P, K_I, ROTOR)

    def image(self, q: Array) -> tuple[Array, Array]:
        """Image of the tool, and the Jacobian of its position."""
        J = pin.computeFrameJacobian(self.model, self.data, q, self.tool, pin.LOCAL_WORLD_ALIGNED)[:3]
        pin.framesForwardKinematics(self.model, self.data, q)
        return seen(self.data.oMf[self.tool].translation)[0], J

    def run(self, q: Array, ticks: int) -> dict[str, Array]:
        """The signals at each sample; Euler steps for the controller's states."""
        plant = self.robot.held(q)
        q_tie, z, y, w, w_P, w_I = q, np.zeros(3), np.zeros(3), np.zeros(3), np.full(3, 2.0), np.full(3, 0.7)
        a, a_c = np.zeros(39), GUESS
        kept: dict[str, list[Array]] = {name: [] for name in ("q", "dq_c", "e", "a_c", "a")}
        for _ in range(ticks + 1):
            q, dq, q_c, _ = plant.reshape(4, 3)
            chi, J = self.image(q)
            e = chi - GOAL
            J_chi = motion(a_c, chi, e) @ J
            pull = J_chi.T @ e
            dq_ref, ddq_ref = -K_2 * y, -K_2 * K_1 * (pull - y)
            Y = self.robot.regressor(q, dq, dq_ref, ddq_ref)
            tau_dc, sigma = Y @ a - ALPHA * pull, dq - dq_ref
            dq_c = dq_ref + w_P * (q_tie - q_c) + w * tau_dc - w_I * z
            for name, value in zip(kept, (q, dq_c, e, a_c, a), strict=True):
                kept[name].append(np.array(value))
            dx = J @ dq
            y, q_tie, z, w, w_P, w_I, a, a_c = (
                y + T * K_1 * (pull - y),
                q_tie + T * (dq_ref + K_C * (q - q_tie)),
                z + T * (q_c - q_tie),
                np.clip(w - T * 0.01 * tau_dc * sigma, 0, 0.004),
                np.clip(w_P + T * (q_c - q_tie) * sigma, 1, 3),
                np.clip(w_I + T * z * sigma, 0.5, 2),
                a - T * GAMMA * Y.T @ sigma,
                a_c + T * GAMMA_C * np.concatenate([e[0] * dx, e[1] * dx, -((chi - e / 2) @ e) * dx]),
            )
            plant = self.robot.moved(plant, dq_c, T)
        return {name: np.array(values) for name, values in kept.items()}


def test_the_packaged_loop_is_the_one_written_by_hand() -> None:
    experiment, ticks = Graph.read("ur10_camera", [f"dynamics.Gamma={GAMMA}"]), 125
    solver = Solver(method="cvodes", tolerance=1e-10)
    theirs = simulate(experiment.diagram, ticks * T, clock=T, solver=solver, start=experiment.start)
    mine = ByHand(experiment).run(np.array(experiment.start["q"], dtype=float), ticks)
    assert np.max(np.abs(mine["q"] - mine["q"][0])) > 0.01, "it moves"
    np.testing.assert_allclose(theirs["arm.q"], mine["q"], atol=1e-6)
    np.testing.assert_allclose(theirs["inverse.dq_c"], mine["dq_c"], atol=1e-5)
    np.testing.assert_allclose(theirs["task.e_chi"], mine["e"], atol=1e-6)
    np.testing.assert_allclose(theirs["image.a_c_hat"], mine["a_c"], atol=1e-6)
    np.testing.assert_allclose(theirs["dynamics.a_d_hat"], mine["a"], atol=1e-4)


def test_the_clock_of_8_ms_is_tolerated_and_proved_so_near_the_set_point_and_seven_times_as_slow_a_one_is_not() -> None:
    graph = dm.load("ur10_camera")
    found = linearise(graph.diagram, start=graph.start, clock=T)
    period = linearised_period(found)
    assert T < period.stable < period.unstable < 7 * T
    proof, _ = prove_stability(graph.diagram, found, period, T)
    assert proof.radius is not None
    assert proof.radius < 1
    assert (proof.directions, proof.resting) == (20, 58)
