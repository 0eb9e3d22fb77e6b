"""The sampled law's certificate: proved with both servos, and refuted where a law or a regressor is another."""

from __future__ import annotations

from typing import Any

import casadi as ca
import pytest

import dmframe as dm
from dmframe.certify import Verdict, verify
from dmframe.robot.symbolic import SymbolicRobot
from dmframe_blocks._averaged_servo import AveragedServo, averaged_servo

PID = {"type": "pid_servo", "K_D": [60, 30], "K_P": [120, 60], "K_I": [40, 20]}
PI = {"type": "pi_servo", "K_P": [60, 30], "K_I": [120, 60]}


def verdict(maker: dict[str, Any] = PID, arm: dict[str, Any] | None = None, **inverse: Any) -> Verdict:
    kind = maker["type"].partition("_")[0]
    graph = dm.load(
        {
            "dmframe": 1,
            "robot": "arm2",
            "clock": "40 ms",
            "duration": "4 s",
            "start": {"q": [0.5, 0.9]},
            "blocks": {
                "path": {"type": "circle", "center": [0.6, 0.2], "radius": 0.1, "rate": "0.5 rad/s"},
                "task": {"type": "sampled_tracking", "gamma": 1},
                "inverse": {"type": "sampled_inverse", "servo": kind, "w_0": 0.02, "replay": 2, **inverse},
                "servo": maker,
                "arm": {"type": "manipulator", "viscous": [1, 0.5], "coulomb": [0.5, 0.2], **(arm or {})},
            },
        }
    )
    return verify(graph.diagram)


@pytest.mark.parametrize(
    ("servo", "options"),
    [
        (PID, {}),
        (PI, {}),
        (PID, {"filtered": False}),
        (PID, {"delay": 1}),
        (PI, {"average": 2, "stride": 3, "time_stamps": True, "w_0": [0.02, 0.04]}),
    ],
)
def test_it_is_proved_over_samples(servo: dict[str, Any], options: dict[str, Any]) -> None:
    found = verdict(servo, **options)
    assert found.outcome == "proved", found.reason
    assert all(control.refuted for control in found.controls)
    assert found.samples is not None
    assert found.samples.silent == ("task",)


def _says(found: Verdict) -> str:
    assert found.refutation is not None, found.reason
    return found.refutation.says


@pytest.mark.parametrize("servo", [PID, PI])
@pytest.mark.parametrize("name", ["kinetic_regressor", "gravity_regressor", "momentum_regressor"])
def test_a_wrong_regressor_is_not_what_the_plant_obeys(
    servo: dict[str, Any], name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    right = getattr(SymbolicRobot, name)
    monkeypatch.setattr(SymbolicRobot, name, lambda *given: 2 * right(*given))
    assert _says(verdict(servo)) == "inverse: what the plant's motion obeys"


def test_the_christoffel_matrix_itself_is_not_its_transpose(monkeypatch: pytest.MonkeyPatch) -> None:
    def turned(robot: Any, q: Any, dq: Any) -> Any:
        still = 0 * dq
        return robot.regressor(q, dq, dq, still) - robot.regressor(q, still, still, still)

    monkeypatch.setattr(SymbolicRobot, "kinetic_regressor", turned)
    assert _says(verdict()) == "inverse: what the plant's motion obeys"


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
    assert _says(verdict()) == "inverse: what theta becomes"
    averaged_servo.cache_clear()


def test_rows_that_are_stored_elsewhere_are_refuted(monkeypatch: pytest.MonkeyPatch) -> None:
    averaged_servo.cache_clear()
    monkeypatch.setattr(
        AveragedServo, "pushed", property(lambda self: lambda rows, new: ca.vertcat(rows[1:, :], new.T))
    )
    assert _says(verdict()) == "inverse: what rows keeps"
    averaged_servo.cache_clear()


def test_a_friction_without_a_column_and_a_box_without_the_truth_are_told() -> None:
    found = verdict(friction=["viscous"])
    assert found.outcome != "proved"
    assert "what the plant's motion obeys" in _says(found)
    assert "true value of theta inside its box" in verdict(k_P_box=[3, 6]).reason
    assert verdict(friction=["viscous"], arm={"coulomb": 0}).outcome == "proved"


def test_the_makers_gravity_compensation_needs_columns_of_its_own() -> None:
    assert _says(verdict(arm={"maker_gravity": 0.5})) == "inverse: what the plant's motion obeys"


def test_of_a_pi_servo_as_a_pid_one_is_nothing_to_be_proved() -> None:
    found = verdict(PI, servo="pid")
    assert found.outcome == "not_applicable"
    assert "K_D" in found.reason
