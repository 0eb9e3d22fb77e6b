"""The extended state observer as a baseline: its poles, its disturbance, and its figure next to the others."""

from __future__ import annotations

import numpy as np
import pytest

import dmframe as dm
from dmframe_blocks.extended_state_observer import ExtendedStateObserver


def test_of_an_integrator_with_a_constant_disturbance_both_errors_have_the_double_pole() -> None:
    """q' = dq_c + d; errors q - q_hat and d - d_hat by differences of the block's own rates."""
    omega, d = 3.0, 0.7
    block = ExtendedStateObserver(bandwidth=[omega])

    def error_rate(error: np.ndarray) -> np.ndarray:
        q, dq_r = 0.4, 0.2
        states = {"q_hat": [q - error[0]], "d_hat": [d - error[1]]}
        found = block.evaluate({"q": [q], "dq_r": [dq_r]}, states)
        dq_c = float(np.ravel(found.outputs["dq_c"])[0])
        rates = [float(np.ravel(found.rates[name])[0]) for name in ("q_hat", "d_hat")]
        return np.array([dq_c + d - rates[0], -rates[1]])

    A = np.column_stack([error_rate(unit) - error_rate(np.zeros(2)) for unit in np.eye(2)])
    assert error_rate(np.zeros(2)) == pytest.approx([0, 0])  # d_hat = d is where it rests
    assert np.linalg.eigvals(A) == pytest.approx([-omega, -omega], abs=1e-6)


def test_its_error_is_between_the_kinematic_command_and_the_tuned_law() -> None:
    found = {name: dm.load(name).run().error for name in ("ur10_fast_eso", "ur10_fast_kinematic", "ur10_fast_tuned")}
    rms = {name: error.rms_final for name, error in found.items() if error is not None}
    assert rms["ur10_fast_eso"] == pytest.approx(1.28e-3, rel=0.01)
    assert rms["ur10_fast_tuned"] < rms["ur10_fast_eso"] < rms["ur10_fast_kinematic"]


def test_nothing_is_proved_of_it() -> None:
    verdict = dm.verify("ur10_fast_eso").verdict
    assert verdict.outcome == "not_applicable"
    assert "extended_state_observer has no certificate" in verdict.reason
