"""The sampled law's certificate: proved with both servos, and refuted for a changed law or regressor."""

from __future__ import annotations

from typing import Any

import casadi as ca
import pytest
from sampled_arm2 import sampled_arm2

import dmframe as dm
from dmframe.block.linalg import inverse_spd
from dmframe.certify import Verdict, verify
from dmframe.robot.symbolic import SymbolicRobot
from dmframe_blocks._averaged_servo import AveragedServo, averaged_servo
from dmframe_blocks._sample_estimators import LeastSquares

PID = {"type": "pid_servo", "K_D": [60, 30], "K_P": [120, 60], "K_I": [40, 20]}
SQUARES = {"estimator": "least_squares", "average": 2}
PI = {"type": "pi_servo", "K_P": [60, 30], "K_I": [120, 60]}


def verdict(maker: dict[str, Any] = PID, arm: dict[str, Any] | None = None, **inverse: Any) -> Verdict:
    kind = maker["type"].partition("_")[0]
    memory = {} if "estimator" in inverse else {"replay": 2}
    graph = sampled_arm2(**{"servo": kind, **memory, **inverse})
    graph["blocks"]["servo"] = maker
    graph["blocks"]["arm"] |= arm or {}
    if samples := inverse.get("delay"):
        graph["blocks"]["line"] = {"type": "transport_delay", "samples": samples}
    return verify(dm.load(graph).diagram, trials=1)


@pytest.mark.parametrize(
    ("servo", "options"),
    [
        (PID, {}),
        (PI, {}),
        (PID, {"filtered": False}),
        (PID, {"delay": 1}),
        (PI, {"average": 2, "stride": 3, "time_stamps": True, "w_0": [0.02, 0.04]}),
        (PI, SQUARES),
    ],
)
def test_it_is_proved_over_samples(servo: dict[str, Any], options: dict[str, Any]) -> None:
    found = verdict(servo, **options)
    assert found.outcome == "proved", found.reason
    assert all(control.refuted for control in found.controls)
    assert found.samples is not None
    assert found.samples.silent[0] == "task"
    (delay,) = [item for item in found.conditions if "its rows use a delay of" in item.name]
    assert delay.holds


def _reports(found: Verdict) -> str:
    assert found.refutation is not None, found.reason
    return found.refutation.statement


@pytest.mark.parametrize("servo", [PID, PI])
@pytest.mark.parametrize("name", ["kinetic_regressor", "gravity_regressor", "momentum_regressor"])
def test_a_wrong_regressor_is_not_what_the_plant_obeys(
    servo: dict[str, Any], name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    right = getattr(SymbolicRobot, name)
    monkeypatch.setattr(SymbolicRobot, name, lambda *given: 2 * right(*given))
    assert _reports(verdict(servo)) == "inverse: plant identity"


def test_the_christoffel_matrix_itself_is_not_its_transpose(monkeypatch: pytest.MonkeyPatch) -> None:
    def turned(robot: Any, q: Any, dq: Any) -> Any:
        still = 0 * dq
        return robot.regressor(q, dq, dq, still) - robot.regressor(q, still, still, still)

    monkeypatch.setattr(SymbolicRobot, "kinetic_regressor", turned)
    assert _reports(verdict()) == "inverse: plant identity"


def _greedy(self: AveragedServo, theta: Any, h: Any, g: Any, Gamma: Any, nu: Any) -> Any:
    return theta + Gamma * h * self._each(g - self._sums(h * theta))


def _normed_otherwise(self: AveragedServo, theta: Any, h: Any, g: Any, Gamma: Any, nu: Any) -> Any:
    return theta + Gamma * h * self._each((g - self._sums(h * theta)) / (nu + self._sums(h * h)))


def _away(self: AveragedServo, theta: Any, h: Any, g: Any, Gamma: Any, nu: Any) -> Any:
    return theta - Gamma * h * self._each((g - self._sums(h * theta)) / (nu + self._sums(h * Gamma * h)))


@pytest.mark.parametrize("law", [_greedy, _normed_otherwise, _away])
def test_another_adaptation_is_refuted(law: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    averaged_servo.cache_clear()
    monkeypatch.setattr(AveragedServo, "projected", law)
    assert _reports(verdict()) == "inverse: next value of theta"
    averaged_servo.cache_clear()


def _gain_after(self: LeastSquares, theta: Any, G: Any, h: Any, g: Any, Gamma: Any, nu: Any, box: Any) -> Any:
    P = inverse_spd(ca.diag(1 / Gamma) + G + h @ h.T / nu)
    n = nu + ca.dot(h, P @ h)
    theta = theta + P @ h * (g - ca.dot(h, theta)) / n
    return self.put_back(theta, G + h @ h.T / nu, ca.SX.eye(h.shape[0]), P, box)


def _away_by_squares(self: LeastSquares, theta: Any, G: Any, h: Any, g: Any, Gamma: Any, nu: Any, box: Any) -> Any:
    P = inverse_spd(ca.diag(1 / Gamma) + G)
    n = nu + ca.dot(h, P @ h)
    theta, after = theta - P @ h * (g - ca.dot(h, theta)) / n, P - P @ h @ h.T @ P / n
    return self.put_back(theta, G + h @ h.T / nu, ca.SX.eye(h.shape[0]), after, box)


def _clipped(self: LeastSquares, theta: Any, G: Any, left: Any, right: Any, box: Any) -> Any:
    return ca.fmin(ca.fmax(theta, box[:, 0]), box[:, 1]), G


def _remembering(self: LeastSquares, theta: Any, G: Any, left: Any, right: Any, box: Any) -> Any:
    found, _ = _put_back(self, theta, G, left, right, box)
    return found, G


def _above_its_start(self: LeastSquares, x: Any, h: Any, g: Any, by: Any) -> Any:
    """W is forgotten together with its initial value, so that P exceeds Gamma."""
    theta, kept = _updated(self, x, h, g, by)
    G = ca.SX(kept["gathered"])
    G[0] -= (1 - by.retention) / by.gain[0]
    return theta, {"gathered": G}


_put_back, _updated = LeastSquares.put_back, LeastSquares.updated


@pytest.mark.parametrize(
    ("name", "law", "state"),
    [
        ("step", _gain_after, "theta"),
        ("step", _away_by_squares, "theta"),
        ("put_back", _clipped, "theta"),
        ("put_back", _remembering, "gathered"),
        ("updated", _above_its_start, "gathered"),
    ],
)
def test_another_least_squares_is_refuted(name: str, law: Any, state: str, monkeypatch: pytest.MonkeyPatch) -> None:
    averaged_servo.cache_clear()
    monkeypatch.setattr(LeastSquares, name, law)
    assert _reports(verdict(PI, estimator="least_squares")) == f"inverse: next value of {state}"
    averaged_servo.cache_clear()


def test_rows_that_are_stored_elsewhere_are_refuted(monkeypatch: pytest.MonkeyPatch) -> None:
    averaged_servo.cache_clear()
    monkeypatch.setattr(
        AveragedServo, "pushed", property(lambda self: lambda rows, new: ca.vertcat(rows[1:, :], new.T))
    )
    assert _reports(verdict()) == "inverse: next value of rows"
    averaged_servo.cache_clear()


def test_a_friction_without_a_column_and_a_box_without_the_truth_are_reported() -> None:
    found = verdict(friction=["viscous"])
    assert found.outcome != "proved"
    assert "plant identity" in _reports(found)
    assert "true value of theta inside its box" in verdict(k_P_box=[3, 6]).reason
    assert verdict(friction=["viscous"], arm={"coulomb": 0}).outcome == "proved"


def test_the_manufacturers_gravity_compensation_needs_columns_of_its_own() -> None:
    assert _reports(verdict(arm={"maker_gravity": 0.5})) == "inverse: plant identity"


def test_a_pi_servo_declared_as_pid_is_not_proved() -> None:
    found = verdict(PI, servo="pid")
    assert found.outcome == "not_applicable"
    assert "K_D" in found.reason
