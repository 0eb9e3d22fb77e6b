"""The two forms of the PID case at the boundary of the paper's condition, where M_bar is exactly zero."""

from __future__ import annotations

from pathlib import Path

import pytest

from dmframe.certify import Verdict, verify
from dmframe.graph.graph import Graph

GENERATORS = {
    "joint": (
        "{type: sinusoid, center: [0.6, 0.9], amplitude: 0.3, rate: 2}",
        "  task: {type: joint_tracking, alpha_bar: 2}\n",
    ),
    "known": (
        "{type: circle, center: [0.5, 0.3], radius: 0.1, rate: 1}",
        "  geometry: {type: kinematics}\n  task: {type: known_tracking, gamma: 2}\n",
    ),
    "passive": (
        "{type: setpoint, x_d: [0.5, 0.3]}",
        "  geometry: {type: kinematics}\n  filter: {type: passive_filter, K_1: 2}\n"
        "  task: {type: filtered_regulation, K_2: 3, alpha: 5}\n",
    ),
}


def proof(folder: Path, generator: str, tie: str, K_c: float) -> Verdict:
    """Without friction M_bar / K_D = K_c + 1 - 2/K_c, which is exactly zero for K_c = 1."""
    path, task = GENERATORS[generator]
    file = folder / "graph.yaml"
    file.write_text(
        f"dmframe: 1\nrobot: arm2\nclock: continuous\nduration: 1\nblocks:\n  path: {path}\n{task}"
        "  model: {type: regressor}\n  dynamics: {type: dynamic_compensator, Gamma: 3}\n"
        f"  inverse: {{type: pid_inverse, tie: {tie}, K_c: {K_c}, Lambda: 0.01, Lambda_P: 1, Lambda_I: 1}}\n"
        "  servo: {type: pid_servo, K_D: 20, K_P: 20, K_I: 40}\n  arm: {type: manipulator}\n",
        encoding="utf-8",
    )
    return verify(Graph.read(file).diagram, trials=1)


def failing(verdict: Verdict) -> list[str]:
    return [item.name for item in verdict.conditions if not item.holds]


def M_bar(verdict: Verdict) -> float | None:
    (found,) = (item.value for item in verdict.conditions if item.name == "inverse: M_bar >= 0")
    return found


@pytest.mark.parametrize(("generator", "tie"), [("joint", "velocity"), ("known", "velocity"), ("passive", "position")])
def test_at_the_boundary_the_papers_own_condition_is_enough(generator: str, tie: str, tmp_path: Path) -> None:
    verdict = proof(tmp_path, generator, tie, 1)
    assert verdict.outcome == "proved", verdict.reason
    assert M_bar(verdict) == 0


@pytest.mark.parametrize("generator", ["joint", "known"])
def test_a_cascade_on_a_tied_position_is_not_paid_for_at_the_boundary_and_is_just_above(
    generator: str, tmp_path: Path
) -> None:
    verdict = proof(tmp_path, generator, "position", 1)
    assert verdict.outcome == "not_applicable"
    assert M_bar(verdict) == 0
    assert failing(verdict) == [
        "the servo level dominates the cascade's cross term; missing is a weight above zero of |q - q_tie|^2 "
        "in the dissipation"
    ]
    assert proof(tmp_path, generator, "position", 1.01).outcome == "proved"


@pytest.mark.parametrize(("generator", "tie"), [("joint", "velocity"), ("passive", "position")])
def test_just_below_the_boundary_nothing_is_proved(generator: str, tie: str, tmp_path: Path) -> None:
    verdict = proof(tmp_path, generator, tie, 0.99)
    assert verdict.outcome == "not_applicable"
    assert failing(verdict)[0] == "inverse: M_bar >= 0"


def test_the_passive_filter_needs_the_position_tied(tmp_path: Path) -> None:
    assert proof(tmp_path, "passive", "velocity", 2).outcome == "refuted"
    assert proof(tmp_path, "passive", "position", 2).outcome == "proved"
