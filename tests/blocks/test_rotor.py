"""Rotor inertia in plant, regressor and base parameters, compared with Pinocchio's armature."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

import dmframe as dm
from dmframe.block import Equations
from dmframe.certify import claim_of, verify
from dmframe.certify.definite import is_mass_matrix
from dmframe.diagram import Diagram
from dmframe.regressor.base_parameters import base_parameters
from dmframe.regressor.export import regressor_function
from dmframe.robot.chain import SerialChain, pin_configuration
from dmframe.robot.library import load
from dmframe.robot.parameters import DynamicParameters
from dmframe_blocks.regressor import Regressor

ROTORS = (3.0, 3.0, 1.5)
UR10 = (
    "robot: {model: ur10, free: [shoulder_pan_joint, shoulder_lift_joint, elbow_joint],"
    " hold: {wrist_2_joint: -90 deg}, tool: ee_link}"
)
INVERSES = {
    "PI": (
        "{type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w_I: 4}",
        "{type: pi_servo, K_P: [600, 600, 300], K_I: [2400, 2400, 1200]}",
    ),
    "PID": (
        "{type: pid_inverse, K_c: 1, Lambda: 0.01, Lambda_P: 1, Lambda_I: 1, w_P: 2, w_I: 1}",
        "{type: pid_servo, K_D: 800, K_P: 1760, K_I: 560}",
    ),
}


def chain() -> SerialChain:
    free = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"]
    return load("ur10", free=free, hold={"wrist_2_joint": -np.pi / 2}, tool="ee_link")


def with_armature(robot: SerialChain) -> Any:
    model = robot.model.copy()
    model.armature = np.array(ROTORS)
    return model


def graph(folder: Path, servo: str = "PI", rotors: str = "true", arm: str = "manipulator") -> dm.Graph:
    inverse, law = INVERSES[servo]
    file = folder / "rotors.yaml"
    file.write_text(
        f"dmframe: 1\n{UR10}\nclock: 4 ms\nduration: 1 s\nblocks:\n"
        "  path: {type: sinusoid, center: [1.4, -1, 1], amplitude: 0.3, rate: 3}\n"
        "  task: {type: joint_tracking, alpha_bar: 2}\n"
        f"  model: {{type: regressor, friction: [viscous], rotors: {rotors}}}\n"
        "  dynamics: {type: dynamic_compensator, Gamma: 10}\n"
        f"  inverse: {inverse}\n  servo: {law}\n"
        f"  arm: {{type: {arm}, viscous: [5, 5, 2], rotor: {list(ROTORS)}}}\n",
        encoding="utf-8",
    )
    return dm.load(str(file))


@pytest.mark.parametrize("arm", ["manipulator", "loaded_manipulator"])
def test_the_plant_accelerates_as_pinocchios_model_with_an_armature(arm: str, tmp_path: Path) -> None:
    run, robot = graph(tmp_path, arm=arm).run(), chain()
    model = with_armature(robot)
    for k in range(0, 250, 10):
        q, dq, u, ddq = (run[name].values[k] for name in ("arm.q", "arm.dq", "servo.u", "arm.ddq"))
        expected = pin.aba(model, model.createData(), pin_configuration(robot, q), dq, u - np.array([5, 5, 2]) * dq)
        np.testing.assert_allclose(ddq, expected, rtol=0, atol=1e-8 * (1 + np.max(np.abs(expected))))


def regressor_rows(robot: SerialChain, count: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Rows of the full regressor with rotors at random motions, and Pinocchio's torque there."""
    function, rng, model = regressor_function(robot, ("rotor",)), np.random.default_rng(3), with_armature(robot)
    rows, torques = [], []
    for _ in range(count):
        q, dq, ddq = rng.uniform(-2, 2, (3, robot.n))
        rows.append(np.array(function(q, dq, dq, ddq)))
        torques.append(pin.rnea(model, model.createData(), pin_configuration(robot, q), dq, ddq))
    return np.vstack(rows), np.concatenate(torques)


def test_the_regressor_times_the_parameters_is_pinocchios_torque_with_an_armature() -> None:
    robot = chain()
    Y, tau = regressor_rows(robot, 30)
    a = [float(value) for row in robot.inertia for value in row] + list(ROTORS)
    assert DynamicParameters(robot, ("rotor",)).names[-3:] == ("I_r1", "I_r2", "I_r3")
    np.testing.assert_allclose(Y @ a, tau, rtol=0, atol=1e-9 * np.max(np.abs(tau)))


def test_base_parameters_group_the_rotors_of_the_first_joints_with_their_links() -> None:
    """16 of 33: only the third rotor has a separate parameter, in agreement with the numerical rank."""
    robot = chain()
    found = base_parameters(robot, ("rotor",))
    assert found.count == 16
    owners = [text for text in found.symbolic if "I_r" in text]
    assert [name in text for name, text in zip(("I_r1", "I_r2", "I_r3"), owners, strict=True)] == [True] * 3
    assert owners[2] == "I_r3"
    Y, _ = regressor_rows(robot, 40)
    grouping = np.array([[float(x) for x in row] for row in found.grouping])
    assert np.max(np.abs(Y[:, found.independent] @ grouping - Y)) < 1e-8 * np.max(np.abs(Y))
    assert np.linalg.matrix_rank(Y, tol=1e-8 * np.max(np.abs(Y))) == 16


@pytest.mark.parametrize(
    ("servo", "arm"), [("PI", "manipulator"), ("PID", "manipulator"), ("PI", "loaded_manipulator")]
)
def test_rotors_with_columns_are_proved_with_a_positive_definite_mass_matrix(
    servo: str, arm: str, tmp_path: Path
) -> None:
    verdict = graph(tmp_path, servo, arm=arm).verify().verdict
    assert verdict.outcome == "proved"
    assert any(item.name == "M(q) > 0" for item in verdict.conditions)
    assert not [item.text for item in verdict.assumptions if "that it inverts" in item.text]


def test_a_mass_matrix_stays_one_with_rotors_added_and_not_with_rotors_subtracted(tmp_path: Path) -> None:
    diagram = graph(tmp_path).diagram
    claim, robot = claim_of(diagram), diagram.models["arm"].robot
    (q,) = (variable.symbol for variable in diagram.loop.variables if variable.label == "arm.q")
    parameters = {parameter.label: parameter.symbol for parameter in diagram.loop.parameters}
    M, rotor = robot.mass_matrix(q), ca.diag(parameters["arm.rotor"])
    assert is_mass_matrix(claim, M)
    assert is_mass_matrix(claim, M + rotor)
    assert not is_mass_matrix(claim, M - rotor)


def test_rotors_without_columns_are_blamed_by_name(tmp_path: Path) -> None:
    verdict = graph(tmp_path, rotors="false").verify().verdict
    assert verdict.outcome == "refuted"
    text = "the plant has rotor inertia (arm.rotor), and the regressor has no column for it: set rotors: true"
    assert f"model: {text}" in verdict.reason


def test_columns_of_rotors_without_rotors_are_harmless(tmp_path: Path) -> None:
    assert graph(tmp_path).set({"arm.rotor": None}).verify().proved


def test_columns_of_rotors_with_a_wrong_sign_are_refuted(tmp_path: Path) -> None:
    class Wrong(Regressor):  # type: ignore[misc]
        """With a seeded fault, and without printed laws."""

        def equations(self, u: Any, x: Any, p: Any) -> Equations:
            """The columns of the rotors, subtracted."""
            own = super().equations(u, x, p)
            Y, places = own.outputs["Y_d"], self._parameters(p.robot.chain).places("rotor")
            Y[:, places] = -Y[:, places]
            return Equations({**own.outputs, "Y_d": Y})

    sound = graph(tmp_path)
    given = {key: value for key, value in sound.blocks["model"].model_dump().items() if value is not None}
    blocks = {**sound.blocks, "model": Wrong(**given)}
    assert verify(Diagram.build(blocks, sound.file.wires, sound.robot)).outcome == "refuted"


def test_nothing_is_proved_of_a_known_model_that_lacks_the_rotors() -> None:
    assert dm.load("computed_torque").verify().proved
    found = dm.load("computed_torque").set({"arm.rotor": 0.1}).verify()
    assert found.outcome == "refuted"
    assert "torque: what the plant has beyond the links of (1) has to be estimated" in found.verdict.reason
