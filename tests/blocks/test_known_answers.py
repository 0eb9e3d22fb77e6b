"""Each block's equations compared with numbers computed by hand."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np
import pytest

import dmframe as dm
from dmframe.block import AbstractBlock, Signals
from dmframe.block.model import model_block
from dmframe.block.sizes import bind_sizes, parameter_arrays
from dmframe.catalogue import find_block
from dmframe.common.errors import DmframeError
from dmframe.graph.graph import Graph
from dmframe.robot.library import load
from dmframe.robot.symbolic import SymbolicRobot
from dmframe.simulate import simulate
from dmframe_plants.arm2 import closed_form


def answer(kind: str, /, given: Mapping[str, Any] | None = None, robot: Any = None, **numbers: Any) -> dict[str, Any]:
    """Outputs, and rates as ``d(state)``, of one block at given inputs and states; all other symbols are zero."""
    block = find_block(kind)(**(given or {}))
    sizes, _ = bind_sizes({kind: block}, robot)
    for letter, size in {"n": 2, "m": 2, "p": 3}.items():
        if letter not in sizes.bound:
            sizes.bind(letter, size, "the test")
    values, wrong = parameter_arrays(kind, block, sizes)
    assert not wrong
    symbolic = SymbolicRobot(robot) if robot else None
    model = model_block(kind, block, values, sizes, symbolic)
    constants = symbolic.values() if symbolic else {}
    symbols = [*model.inputs.items(), *model.states.items(), *model.parameters.items()]
    symbols += [(c.name, c.symbol) for c in (symbolic.constants if symbolic else ())]
    known = {name: np.zeros(symbol.shape) for name, symbol in symbols} | constants | values | numbers
    assert known.keys() == dict(symbols).keys() | values.keys(), "a number for a symbol that the block has not"
    inputs = [ca.DM(np.reshape(known[name], symbol.shape)) for name, symbol in symbols]
    stated = {**model.equations.outputs, **{f"d({key})": rate for key, rate in model.equations.rates.items()}}
    function = ca.Function("answer", [symbol for _, symbol in symbols], [ca.densify(item) for item in stated.values()])
    results = function(*inputs)
    results = results if isinstance(results, tuple) else (results,)
    return {key: np.squeeze(result.full()) for key, result in zip(stated, results, strict=True)}


def close(found: Any, expected: Any) -> None:
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)


def test_a_circle_begins_at_its_top_and_turns_towards_the_first_axis() -> None:
    given = {"center": [1, 2, 3], "radius": 0.5, "rate": "90 deg/s", "phase": 0}
    close(answer("circle", given, t=0.0)["x_d"], [1, 2.5, 3])
    close(answer("circle", given, t=1.0)["x_d"], [1.5, 2, 3])
    close(answer("circle", {**given, "plane": "yz"}, t=1.0)["x_d"], [1, 2.5, 3])
    close(answer("circle", {**given, "plane": "xz", "phase": "90 deg"}, t=0.0)["x_d"], [1.5, 2, 3])
    close(answer("circle", {"center": [1, 2], "radius": 0.5, "rate": 1}, t=0.0)["x_d"], [1, 2.5])


def test_a_setpoint_is_its_goal() -> None:
    close(answer("setpoint", {"x_d": [0.1, -0.2]})["x_d"], [0.1, -0.2])
    close(answer("setpoint", {"q_d": ["90 deg", 0]})["q_d"], [np.pi / 2, 0])
    close(answer("setpoint", {"chi_d": [0.1, 0]})["chi_d"], [0.1, 0])


@pytest.mark.parametrize(
    ("given", "found"),
    [({}, "none"), ({"x_d": [0.1], "q_d": [0.2]}, "x_d and q_d"), ({"q_d": [0.2], "chi_d": [0, 0]}, "q_d and chi_d")],
    ids=["none", "two", "another two"],
)
def test_a_setpoint_has_one_goal(given: dict[str, Any], found: str) -> None:
    with pytest.raises(DmframeError) as caught:
        find_block("setpoint")(**given)
    assert str(caught.value) == f"setpoint: expected one of x_d, q_d and chi_d, found {found}"


def test_a_sinusoid_swings_each_joint_about_its_middle() -> None:
    given = {"center": [1, 2], "amplitude": [0.1, 0.2], "rate": [1, 2], "phase": [0, np.pi / 2]}
    close(answer("sinusoid", given, t=np.pi / 2)["q_d"], [1.1, 1.8])


def test_waypoints_are_met_at_rest_and_passed_half_way_at_half_time() -> None:
    given = {"times": [1, 3, 4], "q_d": [[0, 1], [2, 5], [2, 4]]}
    for t, q_d in ((0.0, [0, 1]), (1.0, [0, 1]), (2.0, [1, 3]), (3.0, [2, 5]), (3.5, [2, 4.5]), (9.0, [2, 4])):
        close(answer("waypoints", given, t=t)["q_d"], q_d)
    quarter = 10 / 4**3 - 15 / 4**4 + 6 / 4**5
    close(answer("waypoints", given, t=1.5)["q_d"], [2 * quarter, 1 + 4 * quarter])


def test_waypoints_are_met_with_their_velocities_and_accelerations() -> None:
    rows = {"q_d": [[0, 1], [2, 5], [3, 4]], "dq_d": [[0, 0], [0.5, -0.3], [0, 0]], "ddq_d": [[0, 0], [0.2, 4], [0, 0]]}
    given, h = {"times": [1, 3, 4], **rows}, 1e-3

    def at(t: float, **more: Any) -> Any:
        return np.array(answer("waypoints", given | more, t=t)["q_d"]).ravel()

    for t, q_d in ((0.0, [0, 1]), (1.0, [0, 1]), (3.0, [2, 5]), (4.0, [3, 4]), (9.0, [3, 4])):
        close(at(t), q_d)
    before, middle, after = at(3 - h), at(3), at(3 + h)
    np.testing.assert_allclose((after - before) / (2 * h), [0.5, -0.3], atol=1e-4)
    np.testing.assert_allclose((after - 2 * middle + before) / h**2, [0.2, 4], atol=2e-2)
    for t in (1.0, 1.7, 3.2):  # there and back in 6 s
        np.testing.assert_allclose(at(8 - t, after="returns"), at(t), atol=1e-12)
        np.testing.assert_allclose(at(6 + t, after="returns"), at(t), atol=1e-12)


@pytest.mark.parametrize(
    ("more", "text"),
    [
        ({"dq_d": [[0.0], [1.0]]}, "expected dq_d of zero at the first and the last point"),
        ({"dq_d": [[0.0]]}, "expected as many rows of dq_d as times, found 1 and 2"),
        ({"dx_d": [[0.0], [0.0]]}, "expected dq_d with q_d, found dx_d"),
        ({"after": "repeats"}, "expected the last point to be the first one"),
    ],
)
def test_waypoints_with_rates_that_do_not_fit_are_refused(more: dict[str, Any], text: str) -> None:
    with pytest.raises(DmframeError, match=text):
        find_block("waypoints")(**{"times": [0, 1], "q_d": [[0.0], [1.0]], **more})


def test_velocity_steps_change_at_their_times_and_ramps_after_them() -> None:
    given = {"times": [1, 3], "speeds": [[0.2, -0.4], [0, 0.1]]}
    for t, dq_r in ((0.0, [0, 0]), (0.999, [0, 0]), (1.0, [0.2, -0.4]), (2.999, [0.2, -0.4]), (9.0, [0, 0.1])):
        close(answer("velocity_steps", given, t=t)["dq_r"], dq_r)
    for t, dq_r in ((1.0, [0, 0]), (1.5, [0.1, -0.1]), (3.0, [0.2, -0.4]), (3.5, [0.1, -0.275]), (9.0, [0, 0.1])):
        close(answer("velocity_steps", given | {"ramp": [1, 2]}, t=t)["dq_r"], dq_r)


def test_epicycles_add_circles_whose_time_stops_at_each_interval() -> None:
    given = {"center": [1, 2, 3], "radius": [0.5, 0.1], "rate": [2, -1], "phase": [0.3, 1], "plane": "xz"}

    def at(theta: float) -> list[float]:
        x = 1 + 0.5 * math.cos(2 * theta + 0.3) + 0.1 * math.cos(1 - theta)
        return [x, 2, 3 + 0.5 * math.sin(2 * theta + 0.3) + 0.1 * math.sin(1 - theta)]

    close(answer("epicycles", given, t=1.7)["x_d"], at(1.7))
    stopped = given | {"stop": 1, "every": 4, "pause": 0.25}  # motion for 3 s, rest for 1 s
    quarter = 10 / 4**3 - 15 / 4**4 + 6 / 4**5
    for t, theta in ((0.0, 0), (0.75, 4 * quarter), (1.5, 2), (3.0, 4), (3.6, 4), (4.0, 4), (9.5, 10)):
        close(answer("epicycles", stopped, t=t)["x_d"], at(theta))
    close(answer("epicycles", stopped | {"stop": 0.5}, t=3.5)["x_d"], at(3.75))


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"rate": [1]}, "expected a radius, a rate and a phase for each circle, found radius 2, rate 1, phase 2"),
        ({"stop": 1.5}, "expected a stop of at most 1, found 1.5"),
        ({"pause": 1}, "expected a pause below 1, found 1"),
    ],
)
def test_epicycles_refuse(wrong: dict[str, Any], text: str) -> None:
    given = {"center": [1, 2], "radius": [0.5, 0.1], "rate": [2, 1], "phase": [0, 0]}
    with pytest.raises(DmframeError, match=re.escape(text)):
        answer("epicycles", given | wrong, t=0.0)


def test_a_command_gain_multiplies_the_command() -> None:
    close(answer("command_gain", {"gain": 1.3}, dq_c=[1, -2])["dq_gain"], [1.3, -2.6])


def test_joint_tracking_leads_the_error_back() -> None:
    found = answer("joint_tracking", {"alpha_bar": 3}, q=[1, 2], q_d=[0.5, 2.5], dq_d=[0.1, 0.2])
    close(found["dq_r"], [0.1 - 1.5, 0.2 + 1.5])


def test_known_tracking_inverts_the_jacobian_and_pulls_towards_the_path() -> None:
    J = np.array([[1.0, 2.0], [0.5, -1.0]])
    x, x_d, dx_d = np.array([0.3, 0.1]), np.array([0.2, 0.4]), np.array([1.0, -0.5])
    found = answer("known_tracking", {"gamma": 0.8}, J_hat=J, x=x, x_d=x_d, dx_d=dx_d)
    close(found["dq_r"], np.linalg.solve(J, dx_d) - 0.8 * J.T @ (x - x_d))


def test_the_kinematic_command_is_the_reference() -> None:
    close(answer("kinematic_command", dq_r=[1.5, -2])["dq_c"], [1.5, -2])


def test_a_torque_command_damps_the_sliding_variable() -> None:
    found = answer("torque_command", {"K_sigma": [2, 3]}, dq=[1, 2], dq_r=[0.5, 3], tau_dc=[10, 20])
    close(found["dq_ref"], [0.5, 3])
    close(found["sigma"], [0.5, -1])
    close(found["tau_c"], [9, 23])


def test_a_spring_and_a_damper_pull_the_joints_to_their_path() -> None:
    given = {"K_e": [10, 20], "K_sigma": [2, 3]}
    found = answer("pd_torque", given, q=[1, 2], q_d=[0.5, 3], dq=[4, 5], dq_d=[3, 6], tau_dc=[0.5, 0])
    close(found["dq_ref"], [3, 6])
    close(found["sigma"], [1, -1])
    close(found["tau_c"], [0.5 - 5 - 2, 20 + 3])


def test_inverse_dynamics_is_the_textbooks() -> None:
    dq_ref, ddq_ref = np.array([0.3, 0.8]), np.array([-1.0, 2.0])
    found = answer("inverse_dynamics", robot=load("arm2"), q=Q, dq=DQ, dq_ref=dq_ref, ddq_ref=ddq_ref)
    moving = closed_form.mass_matrix(Q) @ ddq_ref + closed_form.coriolis(Q, DQ) @ dq_ref
    np.testing.assert_allclose(found["tau_c"], moving + closed_form.gravity_torque(Q), rtol=1e-11)


def test_inverse_dynamics_of_a_wrong_model_is_the_torque_of_a_lighter_arm_and_is_refuted() -> None:
    signals = {"q": Q, "dq": DQ, "dq_ref": np.array([0.3, 0.8]), "ddq_ref": np.array([-1.0, 2.0])}
    whole = answer("inverse_dynamics", robot=load("arm2"), **signals)["tau_c"]
    light = answer("inverse_dynamics", {"off": -0.2}, robot=load("arm2"), **signals)["tau_c"]
    np.testing.assert_allclose(light, 0.8 * whole, rtol=1e-12)
    graph = dm.load("computed_torque")
    assert graph.verify().outcome == "proved"
    for off in (-0.2, 0.0):  # none except a model that satisfies the equations
        assert graph.set({"torque.off": off}).verify().outcome == "refuted"


def test_a_torque_interface_gives_the_voltage_of_a_torque() -> None:
    close(answer("torque_interface", tau_c=[6, 6], K=[2, 3])["u"], [3, 2])


def test_the_compensator_adapts_down_the_gradient_and_adds_the_task_torque() -> None:
    Y_d = np.array([[1.0, 2, 3], [0, -1, 1]])
    given = {"Gamma": [1, 2, 4]}
    found = answer("dynamic_compensator", given, Y_d=Y_d, sigma=[1, 2], tau_task=[0.5, 0], a_d_hat=[1, 0, 2])
    close(found["tau_dc"], [7.5, 2])
    close(found["d(a_d_hat)"], [-1, 0, -20])


def test_the_pi_inverse_is_eqs_12_14_and_16() -> None:
    given = {"Lambda": 2, "Lambda_I": 3}
    state = {"q_r": [1, 1], "w": [0.1, 0.2], "w_I": [2, 3]}
    found = answer("pi_inverse", given, q_c=[1.5, 0], dq_r=[1, 2], dq=[1.5, 1], tau_dc=[10, 20], **state)
    close(found["dq_ref"], [1, 2])
    close(found["sigma"], [0.5, -1])
    close(found["dq_c"], [1 + 2 * (1 - 1.5) + 1, 2 + 3 * 1 + 4])
    close(found["d(q_r)"], [1, 2])
    close(found["d(w)"], [-10, 40])
    close(found["d(w_I)"], [3 * 0.5 * 0.5, 3 * -1 * -1])


@pytest.mark.parametrize(
    ("tie", "reference", "dq_r", "rate"),
    [("velocity", "q_r", [1.5, 2], [1.5, 2]), ("position", "q_tie", [1, 2], [1.5, 2])],
)
def test_the_pid_inverse_is_eqs_32_to_39(tie: str, reference: str, dq_r: list[float], rate: list[float]) -> None:
    """(32) and (34) have different initial velocities, and are the same law if these give the same dq_ref."""
    given = {"K_c": 0.5, "Lambda": 2, "Lambda_P": 3, "Lambda_I": 4, "tie": tie}
    state = {reference: [1, 1], "z": [0.2, -0.4], "w": [0.1, 0.2], "w_P": [2, 3], "w_I": [5, 6]}
    found = answer("pid_inverse", given, q=[2, 1], q_c=[1.5, 0], dq_r=dq_r, dq=[1.5, 1], tau_dc=[10, 20], **state)
    close(found["dq_ref"], [1, 2])
    close(found["sigma"], [0.5, -1])
    close(found["dq_c"], [1 - 1 + 1 - 1, 2 + 3 + 4 + 2.4])
    close(found[f"d({reference})"], rate)
    close(found["d(z)"], [0.5, -1])
    close(found["d(w)"], [-10, 40])
    close(found["d(w_P)"], [0.75, 3])
    close(found["d(w_I)"], [0.4, 1.6])


def test_the_p_pi_inverse_is_its_own_1_to_7() -> None:
    given = {"K_c": 0.5, "Lambda_f": 5, "Lambda": 2, "Lambda_r": 3, "Lambda_c": 4, "Lambda_z": 6}
    state = {
        "q_r": [1, 1],
        "z": [0.2, -0.4],
        "w_f": [2, 1],
        "w": [0.1, 0.2],
        "w_r": [2, 3],
        "w_c": [4, 1],
        "w_z": [5, 6],
    }
    found = answer("p_pi_inverse", given, q=[2, 1], q_c=[1.5, 0], dq_r=[1.5, 2], dq=[1.5, 1], tau_dc=[10, 20], **state)
    close(found["dq_ref"], [1, 2])
    close(found["sigma"], [0.5, -1])
    close(found["dq_c"], [2 + 1 + 2 - 6 - 1, 2 + 4 + 3 - 0 + 2.4])
    close(found["d(q_r)"], [1.5, 2])
    close(found["d(z)"], [0.5, -1])
    close(found["d(w_f)"], [-5 * 1 * 0.5, 5 * 2 * 1])
    close(found["d(w)"], [-10, 40])
    close(found["d(w_r)"], [-3 * 1 * 0.5, 3 * 1 * 1])
    close(found["d(w_c)"], [4 * 1.5 * 0.5, 0])
    close(found["d(w_z)"], [6 * 0.2 * 0.5, 6 * 0.4])


def test_the_pi_servo_is_eq_6() -> None:
    given = {"K_P": [10, 20], "K_I": [30, 40]}
    found = answer("pi_servo", given, q=[1, 1], dq=[1, 2], dq_c=[0.5, 3], q_c=[0.9, 0.8], i=[0.1, -0.1])
    close(found["u"], [-5 - 3, 20 + 4])
    close(found["d(i)"], [0.5, -1])
    close(found["d(q_c)"], [0.5, 3])
    close(found["q_c"], [0.9, 0.8])


def test_the_pid_servo_is_eq_7() -> None:
    given = {"K_D": [1, 2], "K_P": [10, 20], "K_I": [30, 40]}
    found = answer("pid_servo", given, q=[1, 1], dq=[1, 2], dq_c=[0.5, 3], q_c=[0.9, 0.8], i=[0.1, -0.1])
    close(found["u"], [-0.5 - 1 - 3, 2 - 4 + 4])
    close(found["d(i)"], [0.1, 0.2])
    close(found["d(q_c)"], [0.5, 3])


Q, DQ = np.array([0.4, -0.9]), np.array([1.1, -0.6])


def test_kinematics_and_the_manipulators_position_are_the_textbooks() -> None:
    robot = load("arm2")
    found = answer("kinematics", robot=robot, q=Q, dq=DQ)
    close(found["J_hat"], closed_form.jacobian(Q))
    close(found["dx"], closed_form.jacobian(Q) @ DQ)
    close(answer("manipulator", robot=robot, q=Q)["x"], closed_form.position(Q))


def test_the_manipulator_obeys_the_textbooks_equation_of_motion() -> None:
    given = {"viscous": [1, 0.5], "coulomb": [2, 3], "K": [1.5, 2]}
    u = np.array([3.0, -1.0])
    found = answer("manipulator", given, robot=load("arm2"), q=Q, dq=DQ, u=u)
    torque = np.array([1.5, 2]) * u - np.array([1, 0.5]) * DQ - np.array([2, 3]) * np.tanh(DQ / 0.005)
    rest = closed_form.coriolis(Q, DQ) @ DQ + closed_form.gravity_torque(Q)
    close(found["ddq"], np.linalg.solve(closed_form.mass_matrix(Q), torque - rest))
    close(found["d(dq)"], found["ddq"])
    close(found["d(q)"], DQ)
    close(found["g"], closed_form.gravity_torque(Q))


def test_the_regressor_times_the_true_parameters_is_the_motions_torque() -> None:
    robot = load("arm2")
    dq_ref, ddq_ref, B, D = np.array([0.3, 0.8]), np.array([-1.0, 2.0]), np.array([1, 0.5]), np.array([2.0, 3])
    given = {"friction": ["viscous", "coulomb"]}
    Y_d = answer("regressor", given, robot=robot, q=Q, dq=DQ, dq_ref=dq_ref, ddq_ref=ddq_ref)["Y_d"]
    a_d = np.concatenate([np.array(robot.inertia, dtype=float).ravel(), B, D])
    expected = (
        closed_form.mass_matrix(Q) @ ddq_ref + closed_form.coriolis(Q, DQ) @ dq_ref + closed_form.gravity_torque(Q)
    )
    close(Y_d @ a_d, expected + B * dq_ref + D * np.tanh(dq_ref / 0.005))
    assert answer("regressor", {"friction": []}, robot=robot, q=Q)["Y_d"].shape == (2, 20)


def test_a_frozen_block_cannot_be_changed() -> None:
    block: AbstractBlock = find_block("joint_tracking")(alpha_bar=1)
    with pytest.raises(ValueError, match="frozen"):
        block.alpha_bar = 2  # type: ignore[attr-defined]


X, X_D, X_O = np.array([0.3, 0.1]), np.array([0.2, 0.4]), np.array([0.25, 0.15])
J_HAT = np.array([[1.0, 2.0], [0.5, -1.0]])


def test_the_passive_filter_is_eq_8() -> None:
    found = answer("passive_filter", {"K_1": [2, 3]}, x=X, x_d=X_D, J_hat=J_HAT, y=[0.1, 0.2])
    close(found["y"], [0.1, 0.2])
    close(found["d(y)"], [2 * (-0.05 - 0.1), 3 * (0.5 - 0.2)])  # J'(x - x_d) = [0.1 - 0.15, 0.2 + 0.3]


def test_filtered_regulation_is_eq_9_with_its_passive_torque() -> None:
    given = {"K_2": [2, 3], "alpha": 10}
    found = answer("filtered_regulation", given, y=[0.1, 0.2], x=X, x_d=X_D, J_hat=J_HAT)
    close(found["dq_r"], [-0.2, -0.6])
    close(found["tau_task"], [0.5, -5])
    close(found["e_k"], [0.1, -0.3])


def test_the_task_observer_is_eq_19() -> None:
    found = answer("task_observer", {"beta": 4}, x=X, J_hat=J_HAT, dq_r=[1, 2], x_o=X_O)
    # J'(x_o - x) = [-0.05 + 0.025, -0.1 - 0.05]; dq_r - 4 of it = [1.1, 2.6]
    close(found["d(x_o)"], [1.1 + 5.2, 0.55 - 2.6])
    close(found["x_o"], X_O)


def test_observed_tracking_is_eqs_20_and_30() -> None:
    dx_d = np.array([1.0, -0.5])
    found = answer("observed_tracking", {"gamma": 2}, x=X, x_o=X_O, x_d=X_D, dx_d=dx_d, J_hat=J_HAT)
    # the inverse of J_hat is [[1, 2], [0.5, -1]] / 2; J'(x_o - x_d) = [0.05 - 0.125, 0.1 + 0.25]
    close(found["dq_r"], [0 + 0.15, 0.5 - 0.7])
    close(found["e_k"], [0.1 + 0.05, -0.3 - 0.05])


def test_observed_tracking_of_a_redundant_robot_takes_the_least_velocity_that_differs_from_the_null_spaces() -> None:
    J = np.array([[1.0, 2.0, 0.5], [0.5, -1.0, 1.0]])
    dx_d, dq_null = np.array([0.3, -0.2]), np.array([0.4, -0.1, 0.2])
    block = find_block("observed_tracking")(gamma=1.5)
    q = {name: ca.SX.sym(name, *size) for name, size in {"J_hat": (2, 3), "dx_d": (2,), "dq_null": (3,)}.items()}
    held = {name: ca.SX(X) for name in ("x", "x_o", "x_d")}
    u = Signals("task", "inputs", {**q, **held})
    stated = block.equations(u, Signals("task", "states", {}), Signals("task", "parameters", {"gamma": ca.SX(1.5)}))
    dq_r = ca.Function("dq_r", list(q.values()), [stated.outputs["dq_r"]])(J, dx_d, dq_null)
    close(dq_r.full().ravel(), np.linalg.pinv(J) @ dx_d + dq_null - np.linalg.pinv(J) @ (J @ dq_null))


def turned(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


@pytest.mark.parametrize("adapt", ["all", "links", "tool"])
def test_adaptive_kinematics_are_eqs_4_and_13_of_a_planar_arm_with_wrong_lengths(adapt: str) -> None:
    robot = load("arm2")
    true = np.array([x for joint in robot.joints for x in joint.translation] + list(robot.tool), dtype=float)
    part = {"all": slice(0, 9), "links": slice(0, 6), "tool": slice(6, 9)}[adapt]
    wrong = true.copy()
    wrong[part] += np.linspace(0.02, 0.1, 9)[part]
    e_k = np.array([0.3, -0.2])
    given = {"Gamma_k": 2, "adapt": adapt}
    found = answer("adaptive_kinematics", given, robot=robot, q=Q, dq=DQ, e_k=e_k, a_k_hat=wrong[part])
    quarter, both = turned(np.pi / 2), turned(Q[0] + Q[1])
    upper, fore = quarter @ turned(Q[0]), quarter @ both
    plane = [0, 2]  # the arm moves in x and z
    J = np.column_stack([upper @ wrong[3:6][plane] + fore @ wrong[6:][plane], fore @ wrong[6:][plane]])
    close(found["J_hat"], J)
    Y_k = np.zeros((2, 9))
    Y_k[:, [3, 5]], Y_k[:, [6, 8]] = DQ[0] * upper, DQ.sum() * fore
    close(Y_k @ wrong, J @ DQ)
    close(found["d(a_k_hat)"], 2 * (Y_k.T @ e_k)[part])


def test_the_kinematics_are_fitted_to_the_position_by_least_squares_with_forgetting() -> None:
    robot = load("arm2")
    true = np.array([x for joint in robot.joints for x in joint.translation] + list(robot.tool), dtype=float)
    wrong = true + np.linspace(0.02, 0.1, 9)
    upper, fore = turned(Q[0]), turned(Q[0] + Q[1])
    W = np.zeros((2, 9))
    W[:, [0, 2]], W[:, [3, 5]], W[:, [6, 8]] = np.eye(2), upper, fore
    rng = np.random.default_rng(0)
    root, e_k, x, R, mu = rng.normal(size=(9, 9)), np.array([0.3, -0.2]), np.array([0.4, 0.7]), np.array([5.0, 3]), 0.2
    G, Gamma = root @ root.T, np.linspace(1, 3, 9)
    given = {"Gamma_k": list(Gamma), "R": list(R), "forgetting": mu}
    signals = {"q": Q, "dq": DQ, "e_k": e_k, "x": x, "a_k_hat": wrong, "G_k": G}
    found = answer("adaptive_kinematics", given, robot=robot, **signals)
    driven = answer("adaptive_kinematics", {"Gamma_k": 1}, robot=robot, q=Q, dq=DQ, e_k=e_k, a_k_hat=wrong)[
        "d(a_k_hat)"
    ]
    P = np.linalg.inv(np.diag(1 / Gamma) + G)
    close(found["d(a_k_hat)"], P @ (driven - W.T @ (R * (W @ wrong - x))))
    close(found["d(G_k)"], W.T @ np.diag(R) @ W - mu * G)
    composite = answer("adaptive_kinematics", {"Gamma_k": list(Gamma), "R": list(R)}, robot=robot, **_without(signals))
    close(composite["d(a_k_hat)"], Gamma * (driven - W.T @ (R * (W @ wrong - x))))
    assert "d(G_k)" not in composite


def _without(signals: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: value for name, value in signals.items() if name != "G_k"}


def test_the_accelerometer_outputs_the_acceleration() -> None:
    close(answer("accelerometer", ddq=[1.5, -2])["ddq_m"], [1.5, -2])


def test_computed_torque_is_eqs_59_and_60() -> None:
    found = answer(
        "computed_torque", {"alpha_bar": 3}, q=[1, 2], dq=[1, 1], q_d=[0.5, 2.5], dq_d=[0.2, 2], ddq_d=[7, 8]
    )
    close(found["dq_ref"], [1, 1])
    close(found["ddq_ref"], [7 - 6 * 0.8 - 9 * 0.5, 8 + 6 + 9 * 0.5])
    close(found["s_star"], [0.8 + 1.5, -1 - 1.5])


Y_D = np.array([[1.0, 2, 3], [0, -1, 1]])


def test_certainty_equivalence_is_the_estimated_dynamics() -> None:
    close(answer("certainty_equivalence", Y_d=Y_D, a_d_hat=[1, 0, 2])["tau_d"], [7, 2])


def test_indirect_adaptation_is_eqs_54_to_58() -> None:
    found = answer("indirect_adaptation", {"Gamma": [1, 2, 4]}, Y_d=Y_D, tau_d=[6, 4], a_d_hat=[1, 0, 2])
    close(found["epsilon"], [1, -2])
    close(found["d(a_d_hat)"], [-1, -8, -4])


def test_direct_adaptation_uses_the_error_through_the_estimated_mass_matrix() -> None:
    M_hat = np.array([[3.0, 1], [1, 2]])
    numbers = {"Y_d": Y_D, "M_hat": M_hat, "s_star": [1, 2], "a_d_hat": [1, 0, 2]}
    found = answer("direct_adaptation", {"Gamma": [1, 2, 4]}, **numbers)
    close(found["epsilon"], [0, 1])
    close(found["d(a_d_hat)"], [0, 2, -4])
    close(found["a_d_hat"], [1, 0, 2])


def test_the_mass_estimate_is_the_textbooks_matrix_of_the_estimated_parameters() -> None:
    robot = load("arm2")
    a_d_hat = np.append(1.5 * np.array(robot.inertia, dtype=float).ravel(), [7, 8])  # two of friction, not in M
    found = mass_estimate(robot, a_d_hat)
    close(found, 1.5 * closed_form.mass_matrix(Q))


def mass_estimate(robot: Any, a_d_hat: np.ndarray) -> np.ndarray:
    block, symbolic = find_block("mass_estimate")(), SymbolicRobot(robot)
    q, a = ca.SX.sym("q", 2), ca.SX.sym("a", a_d_hat.size)
    nothing = Signals("mass", "states", {})
    stated = block.equations(
        Signals("mass", "inputs", {"q": q, "a_d_hat": a}), nothing, Signals("mass", "parameters", {"robot": symbolic})
    )
    symbols = [constant.symbol for constant in symbolic.constants]
    function = ca.Function("M", [q, a, *symbols], [ca.densify(stated.outputs["M_hat"])])
    values = symbolic.values()
    return np.asarray(function(Q, a_d_hat, *(values[c.name] for c in symbolic.constants)).full())


def test_the_pi_torque_inverse_is_eqs_49_to_53() -> None:
    given, state = {"Lambda": 2, "Lambda_I": 3}, {"w": [0.1, 0.2], "w_I": [2, 3]}
    numbers = {"q": [1, 1], "dq": [0.5, 0], "q_c": [1.5, 0], "tau_d": [10, 20], "epsilon": [0.5, -1]}
    found = answer("pi_torque_inverse", given, **numbers, **state)
    close(found["dq_c"], [0.5 - 1 + 1, 3 + 4])
    close(found["d(w)"], [-10, 40])
    close(found["d(w_I)"], [0.75, 3])


def test_the_pid_torque_inverse_is_eqs_49_to_53_with_the_integral() -> None:
    given = {"Lambda": 2, "Lambda_P": 3, "Lambda_I": 4}
    state = {"z": [0.2, -0.4], "w": [0.1, 0.2], "w_P": [2, 3], "w_I": [5, 6]}
    numbers = {"q": [1, 1], "dq": [0.5, 0], "q_c": [1.5, 0], "tau_d": [10, 20], "epsilon": [0.5, -1]}
    found = answer("pid_torque_inverse", given, **numbers, **state)
    close(found["dq_c"], [0.5 - 1 - 1 + 1, 3 + 2.4 + 4])
    close(found["d(z)"], [0.5, -1])
    close(found["d(w)"], [-10, 40])
    close(found["d(w_P)"], [0.75, 3])
    close(found["d(w_I)"], [0.4, 1.6])


def test_the_regressors_bias_is_a_torque_of_each_joint_and_its_nominal_model_holds_gravity_at_rest() -> None:
    robot = load("arm2")
    given = {"friction": ["viscous"], "bias": True, "nominal": 0.8}
    found = answer("regressor", given, robot=robot, q=Q, dq=DQ, dq_ref=[0.3, 0.8])
    close(found["Y_d"][:, 20:22], np.diag([0.3, 0.8]))
    close(found["Y_d"][:, 22:], np.eye(2))
    inertia = 0.8 * np.array(robot.inertia, dtype=float).ravel()
    close(found["a_d_nominal"], np.concatenate([inertia, [0, 0], -0.8 * closed_form.gravity_torque(Q)]))
    at_rest = answer("regressor", given, robot=robot, q=Q)
    close(at_rest["Y_d"] @ at_rest["a_d_nominal"], [0, 0])
    assert "a_d_nominal" not in answer("regressor", robot=robot, q=Q)


def test_the_derived_reference_acceleration_is_the_slope_of_the_reference_while_the_kinematics_adapt() -> None:
    graph = Graph.read("theorem_3", ["geometry.Gamma_k=20", "solver={output: 0.5 ms}"])
    diagram = graph.diagram
    run = simulate(diagram, 0.4, clock=None, solver=graph.solver, start=graph.start)
    assert np.ptp(run["geometry.a_k_hat"], axis=0).max() > 1e-3  # adaptation is active
    loop = diagram.loop
    (derived,) = loop.joined([diagram.resolver.input("model", "ddq_ref")])
    function = ca.Function("ddq_ref", [loop.state, loop.time, loop.p], [loop.on_path(derived)])
    states = np.hstack([run.states[variable.label] for variable in loop.variables])
    rows = range(10, len(run.time) - 10, 25)
    expected = np.array([(run["inverse.dq_ref"][k + 1] - run["inverse.dq_ref"][k - 1]) / 0.001 for k in rows])
    found = np.array([function(states[k], run.time[k], loop.p_values).full().ravel() for k in rows])
    assert np.abs(expected).max() > 0.05
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())
