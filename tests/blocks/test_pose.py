"""Tracking with position and orientation: compared with Pinocchio, exact arithmetic, and a second simulation."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any, cast

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from closed_robot import ClosedRobot
from numpy.typing import NDArray

import dmframe as dm
from dmframe.catalogue import find_block
from dmframe.certify import verify
from dmframe.certify.closure import Closure
from dmframe.certify.limits import Combinations, Goal, Made, Vanishing, combined
from dmframe.common.errors import DmframeError
from dmframe.exact import zero_test
from dmframe.graph.graph import Graph
from dmframe.results.metrics import turn_error
from dmframe.robot.library import load
from dmframe.simulate import Solver, simulate
from dmframe_blocks._quaternions import left, right, turn_from

Array = NDArray[np.float64]
DOWN = [0, "90 deg", 0]


def matrix(p: Array) -> Array:
    """The rotation of a quaternion of any length, by Pinocchio."""
    return np.array(pin.Quaternion(*(p / np.linalg.norm(p))).matrix())


def quaternions(count: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).normal(size=(count, 4))


def is_zero(expression: Any) -> bool:
    symbols = ca.vertcat(*ca.symvar(expression))
    return bool(zero_test(ca.Function("residual", [symbols], [ca.densify(expression)]), trials=2).zero)


def rotation(p: Any) -> Any:
    return left(p) @ right(p).T / ca.sumsqr(p)


P, Q, DP = (ca.SX.sym(name, 4) for name in ("p", "q", "dp"))
OMEGA = 2 * (left(P) @ DP) / ca.sumsqr(P)


def test_a_quaternion_of_any_length_but_zero_is_an_exactly_orthogonal_rotation_that_turns_as_it_states() -> None:
    R = rotation(P)
    assert is_zero(R.T @ R - ca.SX.eye(3))
    assert is_zero(ca.det(R) - 1)
    assert is_zero(ca.jtimes(R, P, DP) - ca.skew(OMEGA) @ R)
    assert not is_zero(ca.jtimes(R, P, DP) + ca.skew(OMEGA) @ R)
    assert not is_zero(left(P).T @ left(P) - ca.SX.eye(4)), "the test finds a matrix that is not orthogonal"
    for p in quaternions(5):
        found = ca.Function("R", [P], [R])(p).full()
        np.testing.assert_allclose(found, matrix(p), atol=1e-14)


def test_the_error_vanishes_at_the_orientation_and_half_a_turn_from_it_and_nowhere_else() -> None:
    R, R_d = rotation(P), rotation(Q)
    e_R, apart = turn_from(R, R_d), ca.sumsqr(ca.vec(R - R_d))
    assert is_zero(ca.sumsqr(e_R) - apart * (8 - apart) / 4)
    assert not is_zero(ca.sumsqr(e_R) - apart * (8 - apart) / 2)


def error_of(R: Array, p_d: Array, **given: Any) -> Any:
    still = {"x": np.zeros(3), "x_d": np.zeros(3), "dx_d": np.zeros(3), "dp_d": np.zeros(4)}
    inputs = {**still, "R": R, "p_d": p_d, "J_pose": np.eye(6), "lever": 1.0}
    return find_block("pose_tracking")(gamma=1).evaluate({**inputs, **given}).outputs


@pytest.mark.parametrize("seed", range(3))
def test_pose_tracking_is_its_law_with_pinocchios_logarithm_and_numpys_pseudo_inverse(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p, p_d, x, x_d, dx_d, dp_d = (rng.normal(size=size) for size in (4, 4, 3, 3, 3, 4))
    J, lever, gamma, n = rng.normal(size=(6, 7)), 0.4, 1.7, 7
    found = find_block("pose_tracking")(gamma=gamma).evaluate(
        {"x": x, "x_d": x_d, "dx_d": dx_d, "R": matrix(p), "p_d": p_d, "dp_d": dp_d, "J_pose": J, "lever": lever,
         "dq_null": np.arange(n) / 7}
    ).outputs  # fmt: skip
    R, R_d, h = matrix(p), matrix(p_d), 1e-6
    omega_d = pin.log3(matrix(p_d + h * dp_d) @ matrix(p_d - h * dp_d).T) / (2 * h)
    turn = pin.log3(R @ R_d.T)
    angle = np.linalg.norm(turn)
    e = np.concatenate([x - x_d, lever * 2 * np.sin(angle) * turn / angle])
    back = np.linalg.pinv(J)
    wished = back @ np.concatenate([dx_d, lever * omega_d]) - gamma * J.T @ e
    wished += (np.eye(n) - back @ J) @ np.arange(n) / 7
    np.testing.assert_allclose(found["dq_r"], wished, atol=1e-8)
    np.testing.assert_allclose(found["R_d"], R_d, atol=1e-14)
    assert found["R_apart"] == pytest.approx(8 * np.sin(angle / 2) ** 2)


def test_half_a_turn_away_the_reference_has_no_error_and_near_there_it_leads_back() -> None:
    p_d, axis = np.array([1.0, 0, 0, 0]), np.array([0.6, 0, 0.8])
    there = error_of(pin.exp3(np.pi * axis), p_d)
    np.testing.assert_allclose(there["dq_r"], 0, atol=1e-14)
    assert there["R_apart"] == pytest.approx(8)
    near = error_of(pin.exp3((np.pi - 0.1) * axis), p_d)
    assert near["dq_r"][3:] @ axis < -0.1


def test_the_tools_orientation_and_the_jacobian_of_its_pose_are_pinocchios() -> None:
    chain = load("ur10")
    q = np.random.default_rng(4).normal(size=6)
    data = chain.model.createData()
    pin.framesForwardKinematics(chain.model, data, q)
    J = pin.computeFrameJacobian(chain.model, data, q, chain.model_tool, pin.LOCAL_WORLD_ALIGNED)
    found = find_block("tool_orientation")(lever=0.3).evaluate({"q": q, "J_hat": J[:3]}, robot="ur10").outputs
    np.testing.assert_allclose(found["R"], data.oMf[chain.model_tool].rotation, atol=1e-12)
    np.testing.assert_allclose(found["J_pose"], np.diag([1, 1, 1, 0.3, 0.3, 0.3]) @ J, atol=1e-12)


def desired(kind: str, t: float, **given: Any) -> tuple[Array, Array]:
    """Orientation and, if there is one, position of a source."""
    found = find_block(kind)(**given).evaluate({"t": t} if kind != "setpoint" else {}).outputs
    return matrix(np.asarray(found["p_d"])), np.asarray(found.get("x_d"))


def test_a_constant_orientation_is_its_rotation_vector_also_at_zero_and_half_a_turn() -> None:
    for v in ([0.3, -0.2, 0.9], [0, 0, 0], [np.pi, 0, 0]):
        R, x_d = desired("setpoint", 0.0, x_d=[1, 2, 3], orientation=v)
        np.testing.assert_allclose(R, pin.exp3(np.array(v, dtype=float)), atol=1e-15)
        np.testing.assert_allclose(x_d, [1, 2, 3])


def test_a_turning_tool_turns_about_an_axis_that_is_fixed_in_space() -> None:
    given = {"orientation": [0.3, -0.2, 0.9], "axis": [0, 3, 4], "amplitude": 0.5, "rate": 2, "phase": 0.1, "spin": 0.7}
    for t in (0.0, 1.3, 20.0):
        angle = 0.7 * t + 0.5 * np.sin(2 * t + 0.1)
        expected = pin.exp3(angle * np.array([0, 0.6, 0.8])) @ pin.exp3(np.array([0.3, -0.2, 0.9]))
        np.testing.assert_allclose(desired("turning", t, **given)[0], expected, atol=1e-14)


def test_orientations_of_waypoints_are_met_at_rest_and_joined_on_the_shortest_way() -> None:
    rows = [[0, 0, 0], [2.5, 0, 0], [0, 0, -3.0], [0, 0, -3.0]]
    given = {"times": [0, 1, 3, 4], "x_d": [[0, 0, 0]] * 4, "orientations": rows}
    met = [pin.Quaternion(pin.exp3(np.array(row, dtype=float))) for row in rows]
    for k, t in enumerate(given["times"]):
        np.testing.assert_allclose(desired("waypoints", t, **given)[0], met[k].matrix(), atol=1e-14)
        h = 1e-3
        moved = pin.log3(desired("waypoints", t + h, **given)[0] @ desired("waypoints", t - h, **given)[0].T)
        assert np.linalg.norm(moved) < 1e-6, "at rest"
    for t, k, share in ((0.5, 0, 0.5), (0.25, 0, 0.103515625), (2.0, 1, 0.5), (3.7, 2, 0.3)):
        half_way = met[k].slerp(share, met[k + 1])
        np.testing.assert_allclose(desired("waypoints", t, **given)[0], half_way.matrix(), atol=1e-14)


def test_a_spiral_keeps_to_its_ball_with_the_tool_at_right_angles_to_it() -> None:
    center, down = np.array([0.4, 0.5, -0.2]), pin.exp3(np.array([0, np.pi / 2, 0]))
    given = {"center": center.tolist(), "radius": 0.5, "lean": 0.3, "rate": 0.5, "breath": 0.2, "orientation": DOWN}
    np.testing.assert_allclose(desired("spiral", 0.0, **given)[0], down, atol=1e-15)
    leans = []
    for t in np.linspace(0, 5 * np.pi, 9):
        R_d, x_d = desired("spiral", t, **given)
        out = (x_d - center) / np.linalg.norm(x_d - center)
        assert np.linalg.norm(x_d - center) == pytest.approx(0.5)
        np.testing.assert_allclose(R_d @ down.T @ [0, 0, 1], out, atol=1e-14)  # pointing upwards at the top
        np.testing.assert_allclose(R_d[:, 0], -out, atol=1e-14)  # along the tool's axis, into the ball
        leans.append(np.arccos(out[2]))
    np.testing.assert_allclose(leans, 0.15 * (1 - np.cos(0.2 * np.linspace(0, 5 * np.pi, 9))), atol=1e-7)


@pytest.mark.parametrize(
    ("kind", "given", "text"),
    [
        ("turning", {"orientation": [0, 0, 0], "axis": [0, 0, 0]}, "found [0.0, 0.0, 0.0], of length 0"),
        (
            "waypoints",
            {"times": [0, 1], "x_d": [[0], [1]], "orientations": [[0, 0, 0]]},
            "expected as many orientations as times, found 1 and 2",
        ),
    ],
)
def test_a_source_of_orientations_states_what_is_wrong(kind: str, given: dict[str, Any], text: str) -> None:
    with pytest.raises(DmframeError) as caught:
        find_block(kind)(**given)
    assert text in str(caught.value)


PI = """
  dynamics:    {type: dynamic_compensator, Gamma: 10}
  inverse:     {type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w_I: 2, w_I_box: [0.5, 10]}
  servo:       {type: pi_servo, K_P: 60, K_I: 240}
  arm:         {type: manipulator, viscous: 1}
"""


def with_pi_servo() -> Graph:
    text = dm.load("ur10_pose").text.partition("baseline:")[0]
    kept = re.sub(r"(?m)^  (#|dynamics|inverse|servo|arm).*\n(    .*\n| {17}.*\n)*", "", text)
    return dm.load(kept + PI[1:])


def test_it_goes_with_a_pi_servo_and_ends_in_position_and_orientation() -> None:
    verdict = with_pi_servo().verify().verdict
    assert verdict.outcome == "proved"
    assert len(verdict.controls) >= 19
    assert all(control.refuted for control in verdict.controls)
    gone = {item.signal for item in verdict.statements if item.says == "goes to zero"}
    assert {"x - x_d", "e_R"} <= gone
    assert "vec(R - E G'/|p_d|^2)" not in gone, "half a turn away it stays"
    claim = verdict.claim
    assert claim is not None
    (task,) = (part.certificate for part in claim.parts if part.certificate.errors)
    b, e_R = task.dissipation[0], task.errors[0]
    known = cast(Closure, SimpleNamespace(uncertain=frozenset(), prime=2**127 - 1, seed=0, linear=[], driving=[]))

    def concluded(vector: Any) -> Made | None:
        field = Combinations(claim, known.prime, known.seed)
        return combined(field, known, Goal("it", vector), [Vanishing("b", b.vector, True)])

    assert concluded(e_R.vector) is not None
    assert concluded(e_R.vector + 1) is None
    assert concluded(e_R.vector + claim.loop.variables[-1].symbol[:3]) is None
    assert concluded(task.storage[1].vector[:3]) is None


STILL = {"type": "setpoint", "x_d": [0.4, 0.5, 0.3], "orientation": DOWN}


@pytest.mark.parametrize("tie", ["velocity", "position"])
@pytest.mark.parametrize("name", ["ur10_pose", "ur10_pose_observed"])
def test_it_is_proved_with_a_pid_servo_in_both_forms_known_and_observed(name: str, tie: str) -> None:
    graph = dm.load(name).set({"blocks.path": STILL, "dynamics.Gamma": 10, "inverse.tie": tie})
    verdict = verify(graph.diagram, trials=1, start=graph.start)
    assert verdict.outcome == "proved", verdict.reason
    assert len(verdict.controls) >= 25
    assert all(control.refuted for control in verdict.controls)
    gone = {item.signal for item in verdict.statements if item.says == "goes to zero"}
    assert {"x - x_d", "e_R"} <= gone


OLD: dict[str, Any] = {
    "task.gamma": 3,
    "dynamics.Gamma": {"inverse_of": "model", "scale": 30, "others": 10},
    "inverse.K_c": 1.5,
    "inverse.Lambda": 0.01,
    "inverse.w": 0,
    "inverse.w_box": [[0, 0, 0, 0, 0, 0], [0.004, 0.004, 0.008, 0.2, 0.4, 4]],
}
"""Gains with the same accuracy in the ideal loop, with which the wrist identifies a load as Coulomb friction."""


@pytest.mark.parametrize(("changes", "borne"), [({}, True), (OLD, False)])
def test_a_load_put_into_the_hand_behind_a_delay_is_tolerated_by_the_packaged_gains(
    changes: dict[str, Any], borne: bool
) -> None:
    real = {
        "encoder": {"step": "47.94 urad"},
        "transport_delay": {"samples": 1},
        "loaded_manipulator": {"payload": [4], "payload_at": ["10 s"]},
    }
    run = dm.load("ur10_pose").set(changes).reality(real).run("24 s", judge=False)
    assert (run.divergence is None) == borne
    assert run.error is not None
    if borne:
        assert run.turn is not None
        assert 3e-3 < run.error.norm[run.time >= 10].max() < 7e-3, "the load is felt"
        assert run.error.rms_final is not None
        assert run.error.rms_final < 1e-3
        assert run.turn.rms_final is not None
        assert run.turn.rms_final < 0.1


V_0 = 0.005  # [rad/s] of Coulomb friction
K_D = np.array([800, 800, 400, 100, 100, 100])
K_P, K_I = 2.2 * K_D, 0.7 * K_D
VISCOUS, COULOMB = np.array([19.7, 16.8, 8.9, 3.9, 2.7, 3.2]), np.array([13.6, 14.9, 5.8, 2.6, 3.3, 2.5])
ROTOR = np.array([2.5, 4.7, 1.2, 0.57, 0.32, 0.45])
LEVER, GAMMA, K_C, GAIN, BREATH, T = 0.5, 8.0, 6.0, 10.0, 1.0, 0.008
W, LAMBDA = np.array([2e-4, 2e-4, 4e-4, 1.6e-3, 1.6e-3, 1.6e-3]), np.array([1e-3, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5])
W_ENDS = np.array([[1e-4, 1e-4, 2e-4, 8e-4, 8e-4, 8e-4], [0.0025, 0.0025, 0.005, 0.02, 0.02, 0.02]])


class ByHand:
    """`ur10_pose` with a faster start, in NumPy and Pinocchio: path, reference, adaptive law, servo and robot."""

    def __init__(self) -> None:
        self.model = load("ur10").model.copy()
        self.tool, self.data = self.model.getFrameId("ee_link"), self.model.createData()
        self.robot = ClosedRobot(self.model, VISCOUS, COULOMB, K_D, K_P, K_I, ROTOR)

    def path(self, t: float) -> tuple[Array, Array, Array]:
        """R_d, x_d, and the velocities of both: the tool is tilted by b about the horizontal axis n."""
        b, db, a, da = 0.15 * (1 - np.cos(BREATH * t)), 0.15 * BREATH * np.sin(BREATH * t), 0.5 * t, 0.5
        n, dn = np.array([-np.cos(a), np.sin(a), 0]), da * np.array([np.sin(a), np.cos(a), 0])
        omega = db * n + np.sin(b) * dn + (1 - np.cos(b)) * np.cross(n, dn)
        out = pin.exp3(b * n) @ [0, 0, 1]
        moving = np.concatenate([0.5 * np.cross(omega, out), omega])
        return pin.exp3(b * n) @ pin.exp3(np.array([0, np.pi / 2, 0])), np.array([0.4, 0.5, -0.2]) + 0.5 * out, moving

    def reference(self, t: float, q: Array) -> Array:
        """dq_r."""
        R_d, x_d, moving = self.path(t)
        pin.framesForwardKinematics(self.model, self.data, q)
        J = pin.computeFrameJacobian(self.model, self.data, q, self.tool, pin.LOCAL_WORLD_ALIGNED)
        place = self.data.oMf[self.tool]
        turn = pin.log3(place.rotation @ R_d.T)
        angle = max(float(np.linalg.norm(turn)), 1e-12)
        e = np.concatenate([place.translation - x_d, LEVER**2 * 2 * np.sin(angle) / angle * turn])
        return np.array(np.linalg.solve(J, moving) - GAMMA * J.T @ e)

    def run(self, q: Array, ticks: int) -> dict[str, Array]:
        """The controller's signals at each sample; Euler steps for its states."""
        plant = self.robot.held(q)
        q_r, z, w, w_P, w_I, a = q, np.zeros(6), W, np.full(6, 2.0), np.full(6, 0.7), np.zeros(78)
        kept: dict[str, list[Array]] = {name: [] for name in ("q", "dq_c", "w", "a", "turn")}
        h = 1e-5
        for k in range(ticks + 1):
            q, dq, q_c, _ = plant.reshape(4, 6)
            first = self.reference(k * T, q)
            ends = [self.reference(k * T + way * h, q + way * h * dq) for way in (1, -1)]
            dq_ref, ddq_ref = first - K_C * (q - q_r), (ends[0] - ends[1]) / (2 * h) - K_C * (dq - first)
            Y = self.robot.regressor(q, dq, dq_ref, ddq_ref)
            tau_dc, sigma = Y @ a, dq - dq_ref
            dq_c = dq_ref + w_P * (q_r - q_c) + w * tau_dc - w_I * z
            pin.framesForwardKinematics(self.model, self.data, q)
            turn = pin.log3(self.data.oMf[self.tool].rotation @ self.path(k * T)[0].T)
            for name, value in zip(kept, (q, dq_c, w, a, np.degrees(np.linalg.norm(turn))), strict=True):
                kept[name].append(np.array(value))
            w, w_P, w_I, z, q_r, a = (
                np.clip(w - T * LAMBDA * tau_dc * sigma, *W_ENDS),
                np.clip(w_P + T * (q_c - q_r) * sigma, 1, 3),
                np.clip(w_I + T * z * sigma, 0.5, 2),
                z + T * (q_c - q_r),
                q_r + T * first,
                a - T * GAIN * Y.T @ sigma,
            )
            plant = self.robot.moved(plant, dq_c, T)
        return {name: np.array(values) for name, values in kept.items()}


def test_the_packaged_loop_is_the_one_written_by_hand() -> None:
    graph, ticks = Graph.read("ur10_pose", [f"dynamics.Gamma={GAIN}", f"path.breath={BREATH}"]), 75
    solver = Solver(method="cvodes", tolerance=1e-10)
    theirs = simulate(graph.diagram, ticks * T, clock=T, solver=solver, start=graph.start)
    mine = ByHand().run(np.array(graph.start["q"], dtype=float), ticks)
    assert np.max(np.abs(mine["q"] - mine["q"][0])) > 0.01, "it moves"
    np.testing.assert_allclose(theirs["arm.q"], mine["q"], atol=1e-7)
    np.testing.assert_allclose(theirs["inverse.dq_c"], mine["dq_c"], atol=1e-5)
    np.testing.assert_allclose(theirs["inverse.w"], mine["w"], atol=1e-7)
    np.testing.assert_allclose(theirs["dynamics.a_d_hat"], mine["a"], atol=1e-4)
    turned = turn_error(theirs)
    assert turned is not None
    np.testing.assert_allclose(turned.angle, mine["turn"], atol=1e-5)
    assert turned.angle.max() > 1e-3


CIRCLE = """
dmframe: 1
robot: {model: ur10, tool: ee_link}
clock: 8 ms
duration: 1 s
blocks:
  path:        {type: circle, center: [0.4, 0.45, 0.3], radius: 0.05, rate: 0.5 rad/s}
  attitude:    {type: turning, orientation: [0, 90 deg, 0], axis: [0, 0, 1], amplitude: 20 deg, rate: 0.3 rad/s}
  geometry:    {type: kinematics}
  orientation: {type: tool_orientation, lever: 0.5}
  task:        {type: pose_tracking, gamma: 1}
  inverse:     {type: kinematic_command}
  servo:       {type: pi_servo, K_P: [800, 800, 400, 16, 8, 0.8], K_I: [1760, 1760, 880, 35.2, 17.6, 1.76]}
  arm:         {type: manipulator}
"""


@pytest.mark.parametrize("near", [None, [0.6, -1.5, 2.1, -2.2, -1.5, 0.6]])
def test_a_start_on_a_path_has_its_orientation_too(near: list[float] | None) -> None:
    graph = dm.load(CIRCLE).set({} if near is None else {"start.near": near})
    q = graph.run(until="8 ms", progress=False).recording["arm.q"][0]
    model = load("ur10").model
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    placed = data.oMf[model.getFrameId("ee_link")]
    np.testing.assert_allclose(placed.translation, [0.4, 0.5, 0.3], atol=1e-8)
    np.testing.assert_allclose(placed.rotation, pin.exp3(np.array([0, np.pi / 2, 0])), atol=1e-8)
    if near is not None:
        np.testing.assert_allclose(q, near, atol=0.2)


def test_a_start_that_no_joints_reach_states_by_how_much_in_position_and_angle() -> None:
    graph = dm.load(CIRCLE).set({"path.center": [0.4, 0.45, 2.3]})
    reached = r"= \[0\.4, 0\.5, 2\.3\] with its orientation; the nearest pose is .* m and .* deg away"
    with pytest.raises(DmframeError, match=reached):
        graph.run(progress=False)


def test_a_source_that_no_block_reads_is_reported() -> None:
    graph = dm.load(CIRCLE).set({"blocks.load": {"type": "payload", "mass": [1], "at": [0]}, "duration": 0.08})
    assert graph.run(progress=False).notices[0].startswith("no block reads load.a_load, so that")
    taken = graph.set({"arm.type": "loaded_manipulator"}).run(progress=False)
    assert not [text for text in taken.notices if "no block reads" in text]


SAMPLED = {"type": "sampled_inverse", "servo": "pid", "w_0": [0.00125, 0.00125, 0.0025, 0.01, 0.01, 0.01], "replay": 8}


def test_the_sampled_inverse_takes_its_reference_on_a_slow_clock() -> None:
    slow = dm.load("ur10_pose").baseline().set({"clock": "90 ms"})
    plain, learnt = (graph.run("40 s", judge=False) for graph in (slow, slow.set({"blocks.inverse": SAMPLED})))
    assert plain.error is not None
    assert learnt.error is not None
    assert plain.turn is not None
    assert learnt.turn is not None
    figures = [each.rms_final for each in (learnt.error, learnt.turn, plain.error, plain.turn)]
    np.testing.assert_allclose(np.array(figures, dtype=float), [5.72e-4, 0.0350, 3.21e-3, 0.239], rtol=0.02)
