"""A saturated feedback: its law by hand, its bound, and its proof on a robot."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

import dmframe as dm
from dmframe.catalogue import block_types

GAMMA, WIDTH = 2.0, np.array([0.05, 0.1, 0.2])


def reference(name: str, x: np.ndarray, J: np.ndarray, dx_d: np.ndarray) -> np.ndarray:
    options = {"width": list(WIDTH)} if name == "saturated_tracking" else {}
    block = block_types()[name](gamma=GAMMA, **options)
    found = block.evaluate({"x": x, "x_d": [0.0, 0.0, 0.0], "dx_d": dx_d, "J_hat": J})
    return np.asarray(found.outputs["dq_r"])


@pytest.mark.parametrize("size", [1e-6, 0.1, 100.0])
def test_its_feedback_is_the_slope_of_the_energy_and_never_beyond_its_reach(size: float) -> None:
    rng = np.random.default_rng(0)
    x, dx_d, J = size * rng.normal(size=3), rng.normal(size=3), rng.normal(size=(3, 6))

    def energy(at: np.ndarray) -> float:
        return float(np.sum(WIDTH**2 * (np.hypot(1, at / WIDTH) - 1)))

    slope = scipy.optimize.approx_fprime(x, energy, 1e-7 * max(size, 0.1))
    found = reference("saturated_tracking", x, J, dx_d)
    np.testing.assert_allclose(found, np.linalg.pinv(J) @ dx_d - GAMMA * J.T @ slope, atol=1e-5)
    feedback = np.linalg.norm(found - np.linalg.pinv(J) @ dx_d)
    assert feedback <= GAMMA * np.linalg.norm(J, 2) * np.linalg.norm(WIDTH)
    if size < 1e-3:
        np.testing.assert_allclose(found, reference("known_tracking", x, J, dx_d), rtol=1e-8)


def test_from_far_away_it_commands_less_than_a_linear_feedback_and_arrives() -> None:
    graph = dm.load("ur10_saturated")
    linear = graph.set({"blocks.task": {"type": "known_tracking", "gamma": 2}})
    first = [float(np.max(np.abs(each.run(until=2).data["inverse.dq_c"].values))) for each in (graph, linear)]
    assert first[0] < 0.25 < 0.7 < first[1]
    run = graph.run(until=30)
    assert run.error is not None
    error = np.linalg.norm(run.data["arm.x"].values - run.data["path.x_d"].values, axis=1)
    assert error[0] > 0.6
    assert error[-1] < 5e-3


def test_on_a_robot_it_is_proved_with_every_fault_refuted() -> None:
    graph = dm.load("ur10_saturated")
    verdict = graph.verify().verdict
    assert verdict.outcome == "proved"
    assert len(verdict.controls) == sum(control.refuted for control in verdict.controls) >= 26
    goes = {item.signal for item in verdict.statements if item.says == "goes to zero" and item.concludes}
    assert "x - x_d" in goes
