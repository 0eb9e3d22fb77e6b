"""Servos with built-in compensation of gravity or friction, and an outer loop without information about it."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
import pytest

from dmframe.certify import Verdict, verify
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.simulate import Recording, simulate
from dmframe_plants.arm2 import closed_form

GRAPH = "gravity_compensated_servo"
Q, DQ = np.array([0.4, -0.9]), np.array([1.1, -0.6])


def proof(overrides: Sequence[str] = (), name: str = GRAPH) -> Verdict:
    return verify(Graph.read(name, overrides).diagram, trials=1)


def run(overrides: Sequence[str], duration: float, name: str = GRAPH) -> Recording:
    loaded = Graph.read(name, overrides)
    return simulate(loaded.diagram, duration, clock=loaded.file.clock, solver=loaded.solver, start=loaded.start)


def outputs(diagram: Diagram, block: str, names: Sequence[str], known: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Outputs of one block at given inputs and states, with the graph's values."""
    model = diagram.models[block]
    own = {**model.inputs, **model.states}
    function = ca.Function(
        "outputs", [*own.values(), diagram.loop.p], [model.equations.outputs[name] for name in names]
    )
    given = [known.get(name, np.zeros(symbol.shape)) for name, symbol in own.items()]
    return [np.asarray(value.full()).squeeze() for value in function.call([*given, diagram.loop.p_values])]


def arm2() -> Diagram:
    return Graph.read(
        "arm2_joint",
        ["arm.viscous=[1, 0.5]", "arm.coulomb=[2, 3]", "arm.maker_gravity=0.7", "arm.maker_viscous=[0.8, 0.1]"],
    ).diagram


def test_what_the_manufacturer_compensates_acts_as_a_torque_on_the_textbooks_arm() -> None:
    u = np.array([3.0, -1.0])
    ddq, g, B, share = outputs(arm2(), "arm", ["ddq", "g", "B", "g_share"], {"q": Q, "dq": DQ, "u": u})
    torque = u - np.array([1, 0.5]) * DQ - np.array([2, 3]) * np.tanh(DQ / 0.005)
    torque += 0.7 * closed_form.gravity_torque(Q) + np.array([0.8, 0.1]) * DQ
    rest = closed_form.coriolis(Q, DQ) @ DQ + closed_form.gravity_torque(Q)
    np.testing.assert_allclose(ddq, np.linalg.solve(closed_form.mass_matrix(Q), torque - rest), rtol=1e-11)
    np.testing.assert_allclose(g, 0.3 * closed_form.gravity_torque(Q), rtol=1e-12)
    np.testing.assert_allclose(B, [0.2, 0.4])
    assert share == pytest.approx(0.3)


def test_with_separate_gravity_the_regressor_has_columns_for_motion_and_for_weight() -> None:
    diagram = Graph.read("arm2_joint", ["model.gravity=apart", "model.friction=[]"]).diagram
    dq_ref, ddq_ref = np.array([0.3, 0.8]), np.array([-1.0, 2.0])
    (Y_d,) = outputs(diagram, "model", ["Y_d"], {"q": Q, "dq": DQ, "dq_ref": dq_ref, "ddq_ref": ddq_ref})
    assert Y_d.shape == (2, 28)
    inertia = np.array(diagram.robot.inertia, dtype=float).reshape(2, 10)
    moving = closed_form.mass_matrix(Q) @ ddq_ref + closed_form.coriolis(Q, DQ) @ dq_ref
    np.testing.assert_allclose(Y_d[:, :20] @ inertia.ravel(), moving, rtol=1e-11)
    np.testing.assert_allclose(Y_d[:, 20:] @ inertia[:, :4].ravel(), closed_form.gravity_torque(Q), rtol=1e-11)


def test_the_outer_loop_that_weighs_gravity_separately_is_proved_whatever_the_servo_compensates() -> None:
    for share in (0.95, 1.2):
        assert proof([f"arm.maker_gravity={share}"]).outcome == "proved", share


@pytest.mark.parametrize("name", ["theorem_1", "observed_tracking_pi", "joint_tracking_pid"])
def test_the_same_for_other_generators_and_the_pi_servo(name: str) -> None:
    changes = ["arm.maker_gravity=0.9", "arm.maker_viscous=1", "model.gravity=apart"]
    assert proof(changes, name).outcome == "proved"
    assert proof(["model.gravity=together", *changes[:2]], name).outcome == "refuted"


def test_gravity_tied_to_the_masses_is_refuted_over_a_servo_that_compensates_it() -> None:
    assert proof(["model.gravity=together"]).outcome == "refuted"
    assert proof(["model.gravity=together", "arm.maker_gravity=0"]).outcome == "proved"


def test_compensated_friction_alone_needs_nothing_of_the_outer_loop() -> None:
    assert proof(["model.gravity=together", "arm.maker_gravity=0", "arm.maker_viscous=[5, 5, 2]"]).outcome == "proved"


def test_a_manufacturer_that_compensates_more_friction_than_servo_and_joints_have_is_caught_by_a_condition() -> None:
    verdict = proof(["arm.maker_viscous=[1000, 4, 1.6]"])
    assert verdict.outcome == "not_applicable"
    assert "a condition fails" in verdict.reason
    assert "in the dissipation" in verdict.reason


def test_the_servo_starts_with_the_gravity_that_is_left_to_it() -> None:
    done = run([], 0.08)
    left = run(["arm.maker_gravity=0"], 0.08)
    np.testing.assert_allclose(done["servo.i"][0], 0.05 * left["servo.i"][0], rtol=1e-12)
    assert np.linalg.norm(done["arm.dq"][0]) == 0


def test_the_adaptive_loop_converges_over_the_compensating_servo() -> None:
    done = run([], 60.0)
    assert done.divergence is None
    error = np.linalg.norm(done["arm.x"] - done["path.x_d"], axis=1)
    eighth = len(error) // 8
    rms = [float(np.sqrt(np.mean(error[part] ** 2))) for part in (slice(0, eighth), slice(-eighth, None))]
    assert rms[1] < 0.4 * rms[0]


def test_a_separate_nominal_start_has_the_weights_of_the_robots_model_too() -> None:
    diagram = Graph.read("arm2_joint", ["model.gravity=apart", "model.friction=[]", "model.nominal=0.8"]).diagram
    (nominal,) = outputs(diagram, "model", ["a_d_nominal"], {"q": Q})
    inertia = 0.8 * np.array(diagram.robot.inertia, dtype=float).reshape(2, 10)
    np.testing.assert_allclose(nominal, np.concatenate([inertia.ravel(), inertia[:, :4].ravel()]))
