"""Filtered regressors compared with Pinocchio's, filtered by SciPy; and proofs and runs with them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import scipy

from dmframe.certify import Verdict, verify
from dmframe.common.errors import DmframeError
from dmframe.graph.graph import Graph
from dmframe.robot.chain import SerialChain, pin_configuration
from dmframe.simulate import Solver, simulate

RATE = 20.0
START = "[6, 1.2, 0, 0, 0.01, 0, 0.36, 0, 0, 0.36, 3.5, 0.6, 0, 0, 0.004, 0, 0.15, 0, 0, 0.15, 1, 1, 0, 0]"
STEP = 0.001


def proof(name: str, *overrides: str) -> Verdict:
    return verify(Graph.read(name, overrides).diagram)


def inertial_regressor(chain: SerialChain, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
    data = chain.model.createData()
    return np.array(pin.computeJointTorqueRegressor(chain.model, data, pin_configuration(chain, q), dq, ddq))


def filtered(rows: np.ndarray) -> np.ndarray:
    """RATE / (s + RATE) from rest, by the trapezoidal rule."""
    a = RATE * STEP / 2
    at_rest = -a / (1 + a) * rows[:1]  # so the first output is zero
    return np.asarray(scipy.signal.lfilter([a, a], [1 + a, a - 1], rows, axis=0, zi=at_rest)[0])


def test_the_filter_without_accelerations_is_the_filtered_regressor_with_them() -> None:
    graph = Graph.read("torque_indirect_filtered_pi", [f"filter.bandwidth={RATE}", "adaptation.Gamma=1"])
    diagram = graph.diagram
    run = simulate(diagram, 2.0, clock=None, solver=Solver(step=STEP, output=STEP), start=graph.start)
    q, dq, ddq = run["arm.q"], run["arm.dq"], run["arm.ddq"]
    chain, zero = diagram.robot, np.zeros(2)
    full = np.array([inertial_regressor(chain, *rows) for rows in zip(q, dq, ddq, strict=True)])
    momentum = np.array(
        [
            inertial_regressor(chain, a, zero, b) - inertial_regressor(chain, a, zero, zero)
            for a, b in zip(q, dq, strict=True)
        ]
    )
    Y = np.concatenate([full, dq[:, :, None] * np.eye(2), np.tile(np.eye(2), (len(q), 1, 1))], axis=2)
    P = np.concatenate([momentum, np.zeros((len(q), 2, 4))], axis=2)
    Y_z = run["filter.Y_z"].reshape(len(q), 24, 2).transpose(0, 2, 1)
    found, expected = RATE * P + Y_z, filtered(Y)
    assert np.abs(ddq).max() > 1
    assert np.abs(found[0]).max() < 1e-12
    np.testing.assert_allclose(found, expected, atol=2e-4 * np.abs(expected).max())


def test_with_the_true_estimates_the_prediction_error_stays_zero() -> None:
    graph = Graph.read(
        "torque_indirect_filtered_pi",
        [
            "inverse.w=[0.016666666666666666, 0.03333333333333333]",
            "inverse.w_I=4",
            "adaptation.Gamma=1e-9",
            "inverse.Lambda=1e-12",
            "inverse.Lambda_I=1e-12",
            "model.nominal=1",
            "arm.viscous=0",
        ],
    )
    run = simulate(graph.diagram, 3.0, clock=None, solver=graph.solver, start=graph.start)
    assert np.ptp(run["arm.q"]) > 0.3
    assert np.abs(run["filter.e_f"]).max() < 1e-7
    assert np.abs(run["filter.tau_f"]).max() > 1


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("torque_indirect_filtered_pi", ()),
        ("torque_indirect_filtered_pi", ("filter.weight=[2, 3]", "adaptation.leak=0.1", f"adaptation.a_d_hat={START}")),
        ("known_tracking_composite_pi", ()),
        ("known_tracking_composite_pi", ("dynamics.leak=0.1", "inverse.dead_zone=0.01")),
    ],
)
def test_the_filters_transient_is_stored_and_dissipated_so_that_nothing_is_left_out(
    name: str, overrides: tuple[str, ...]
) -> None:
    verdict = proof(name, *overrides)
    assert verdict.outcome == "proved", verdict.reason
    assert verdict.claim is not None
    (part,) = (part for part in verdict.claim.parts if part.block == "filter")
    assert part.certificate.storage[0].of.startswith("Y_f a_d + K K_I q_f - K_star v_f")
    assert all(control.refuted for control in verdict.controls)
    assert "sign of d filter.Y_z/dt flipped" in [control.fault for control in verdict.controls]


def test_a_filter_without_the_friction_of_the_robot_is_refuted() -> None:
    verdict = proof("torque_indirect_filtered_pi", "filter.friction=[coulomb]", "model.friction=[coulomb]")
    assert verdict.outcome == "refuted"


@pytest.mark.parametrize(
    ("overrides", "found"),
    [(["filter.Gamma_b=1"], "found both"), (["filter.bias=false", "model.bias=false"], "found neither")],
)
def test_the_offset_of_the_servos_integrator_has_one_place(overrides: list[str], found: str) -> None:
    more = ["adaptation.Gamma=1", "adaptation.a_d_hat_box=[-1, 9]"]
    with pytest.raises(DmframeError, match=found):
        _ = Graph.read("torque_indirect_filtered_pi", [*overrides, *more]).diagram


def test_without_accelerations_the_torque_based_arm_follows_its_path_better_and_better() -> None:
    graph = Graph.read("torque_indirect_filtered_pi")
    assert not any("ddq" in leaf.name for leaf in graph.diagram.loop.sampled_signals)
    run = simulate(graph.diagram, 100.0, clock=None, solver=graph.solver, start=graph.start)
    assert run.divergence is None
    for signal, target in (("filter.e_f", 0.7), ("error", 0.7)):
        rows = run[signal] if signal != "error" else run["arm.q"] - run["path.q_d"]
        size = np.linalg.norm(rows, axis=1)
        tenth = size.size // 10
        assert np.sqrt(np.mean(size[-tenth:] ** 2)) < target * np.sqrt(np.mean(size[:tenth] ** 2))


def test_a_composite_adaptation_follows_the_circle_closer_than_the_gradient_alone() -> None:
    final = {}
    for name in ("known_tracking_pi", "known_tracking_composite_pi"):
        graph = Graph.read(name)
        run = simulate(graph.diagram, 40.0, clock=graph.file.clock, solver=graph.solver, start=graph.start)
        assert run.divergence is None
        error = np.linalg.norm(run["arm.x"] - run["path.x_d"], axis=1)
        final[name] = np.sqrt(np.mean(error[-error.size // 4 :] ** 2))
    assert final["known_tracking_composite_pi"] < 0.9 * final["known_tracking_pi"]
