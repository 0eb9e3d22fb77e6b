"""Each block's equations against numbers worked out by hand."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dmframe.block import AbstractBlock
from dmframe.catalogue import find_block
from dmframe.diagram.model import model_block
from dmframe.diagram.sizes import bind_sizes, parameter_arrays
from dmframe.errors import DmframeError
from dmframe.robot.library import load
from dmframe.robot.symbolic import SymbolicRobot
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


@pytest.mark.parametrize(
    ("given", "found"), [({}, "neither"), ({"x_d": [0.1], "q_d": [0.2]}, "both")], ids=["neither", "both"]
)
def test_a_setpoint_has_one_goal(given: dict[str, Any], found: str) -> None:
    with pytest.raises(DmframeError) as caught:
        find_block("setpoint")(**given)
    assert str(caught.value) == f"setpoint: expected one of x_d and q_d, found {found}"


def test_a_sinusoid_swings_each_joint_about_its_middle() -> None:
    given = {"center": [1, 2], "amplitude": [0.1, 0.2], "rate": [1, 2], "phase": [0, np.pi / 2]}
    close(answer("sinusoid", given, t=np.pi / 2)["q_d"], [1.1, 1.8])


def test_waypoints_are_met_at_rest_and_passed_half_way_at_half_time() -> None:
    given = {"times": [1, 3, 4], "q_d": [[0, 1], [2, 5], [2, 4]]}
    for t, q_d in ((0.0, [0, 1]), (1.0, [0, 1]), (2.0, [1, 3]), (3.0, [2, 5]), (3.5, [2, 4.5]), (9.0, [2, 4])):
        close(answer("waypoints", given, t=t)["q_d"], q_d)
    quarter = 10 / 4**3 - 15 / 4**4 + 6 / 4**5
    close(answer("waypoints", given, t=1.5)["q_d"], [2 * quarter, 1 + 4 * quarter])


def test_joint_tracking_leads_the_error_back() -> None:
    found = answer("joint_tracking", {"alpha": 3}, q=[1, 2], q_d=[0.5, 2.5], dq_d=[0.1, 0.2], dq=[1, 1])
    close(found["dq_ref"], [0.1 - 1.5, 0.2 + 1.5])
    close(found["sigma"], [1 + 1.4, 1 - 1.7])


def test_task_tracking_inverts_the_jacobian_and_pulls_towards_the_path() -> None:
    J = np.array([[1.0, 2.0], [0.5, -1.0]])
    x, x_d, dx_d = np.array([0.3, 0.1]), np.array([0.2, 0.4]), np.array([1.0, -0.5])
    found = answer("task_tracking", {"gamma": 0.8}, J_hat=J, x=x, x_d=x_d, dx_d=dx_d, dq=[1, 1])
    expected = np.linalg.solve(J, dx_d) - 0.8 * J.T @ (x - x_d)
    close(found["dq_ref"], expected)
    close(found["sigma"], 1 - expected)


def test_the_kinematic_command_is_the_reference() -> None:
    close(answer("kinematic_command", dq_ref=[1.5, -2])["dq_c"], [1.5, -2])


def test_the_compensator_adapts_down_the_gradient_and_adds_the_task_torque() -> None:
    Y_d = np.array([[1.0, 2, 3], [0, -1, 1]])
    given = {"Gamma": [1, 2, 4]}
    found = answer("dynamic_compensator", given, Y_d=Y_d, sigma=[1, 2], tau_task=[0.5, 0], a_d_hat=[1, 0, 2])
    close(found["tau_dc"], [7.5, 2])
    close(found["d(a_d_hat)"], [-1, 0, -20])


def test_the_pi_inverse_is_eqs_12_14_and_16() -> None:
    given = {"Lambda": 2, "Lambda_I": 3}
    state = {"q_r": [1, 1], "w": [0.1, 0.2], "w_I": [2, 3]}
    found = answer(
        "pi_inverse", given, q=[0, 0], q_c=[1.5, 0], dq_ref=[1, 2], sigma=[0.5, -1], tau_dc=[10, 20], **state
    )
    close(found["dq_c"], [1 + 2 * (1 - 1.5) + 1, 2 + 3 * 1 + 4])
    close(found["d(q_r)"], [1, 2])
    close(found["d(w)"], [-10, 40])
    close(found["d(w_I)"], [3 * 0.5 * 0.5, 3 * -1 * -1])


def test_the_pid_inverse_is_eqs_32_to_39() -> None:
    given = {"K_c": 0.5, "Lambda": 2, "Lambda_P": 3, "Lambda_I": 4}
    state = {"q_r": [1, 1], "z": [0.2, -0.4], "w": [0.1, 0.2], "w_P": [2, 3], "w_I": [5, 6]}
    found = answer(
        "pid_inverse", given, q=[2, 1], q_c=[1.5, 0], dq_ref=[1, 2], sigma=[0.5, -1], tau_dc=[10, 20], **state
    )
    close(found["dq_c"], [1 - 1 + 1 - 1, 2 + 3 + 4 + 2.4])
    close(found["d(q_r)"], [1.5, 2])
    close(found["d(z)"], [0.5, -1])
    close(found["d(w)"], [-10, 40])
    close(found["d(w_P)"], [0.75, 3])
    close(found["d(w_I)"], [0.4, 1.6])


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
    assert answer("regressor", robot=robot, q=Q)["Y_d"].shape == (2, 20)


def test_a_frozen_block_cannot_be_changed() -> None:
    block: AbstractBlock = find_block("joint_tracking")(alpha=1)
    with pytest.raises(ValueError, match="frozen"):
        block.alpha = 2  # type: ignore[attr-defined]
