"""Graphs that violate an assumption of a theorem are refused with the reason."""

from __future__ import annotations

from pathlib import Path

import pytest

from dmframe.catalogue import graphs
from dmframe.certify import verify
from dmframe.common.errors import DmframeError
from dmframe.graph.graph import Graph
from dmframe.simulate import simulate


def changed(folder: Path, name: str, *changes: tuple[str, str]) -> Path:
    text = graphs()[name].read_text(encoding="utf-8").partition("baseline:")[0]
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    file = folder / "graph.yaml"
    file.write_text(text, encoding="utf-8")
    return file


@pytest.mark.parametrize("beta", ["0.888", "0.5"])
def test_an_observer_too_slow_for_the_task_is_not_proved(beta: str) -> None:
    verdict = verify(Graph.read("theorem_3", [f"observer.beta={beta}"]).diagram)  # gamma is 2: 4 gamma / 9 = 0.889
    assert verdict.outcome == "not_applicable"
    assert verdict.reason.startswith("the identity holds, but a condition fails: task: beta > 4 gamma/9")


def test_an_observer_just_fast_enough_is_proved() -> None:
    assert verify(Graph.read("theorem_3", ["observer.beta=0.889"]).diagram).outcome == "proved"


def test_a_projection_box_without_the_truth_is_not_proved() -> None:
    verdict = verify(Graph.read("theorem_2", ["geometry.a_k_hat_box=[-0.1, 0.1]"]).diagram)
    assert verdict.outcome == "not_applicable"
    assert verdict.reason.startswith(
        "the identity holds, but a condition fails: geometry.a_k_hat: true value inside the box"
    )


def test_a_projection_box_without_the_start_does_not_run() -> None:
    graph = Graph.read("theorem_2", ["geometry.a_k_hat_box=[-1, 0.62]"])
    with pytest.raises(DmframeError) as caught:
        simulate(graph.diagram, 0.1, clock=None, start=graph.start)
    assert str(caught.value) == (
        "geometry.a_k_hat[8]: expected a start inside a_k_hat_box, -1 to 0.62, found 0.642; move the start or the box"
    )


@pytest.mark.parametrize("name", ["torque_indirect_pi", "torque_direct_pid"])
def test_the_torque_based_framework_without_an_accelerometer_cannot_read_the_acceleration(
    name: str, tmp_path: Path
) -> None:
    file = changed(tmp_path, name, ("sensor.ddq_m", "arm.ddq"), ("  sensor:   {type: accelerometer}\n", ""))
    with pytest.raises(DmframeError) as caught:
        _ = Graph.read(file).diagram
    assert str(caught.value).endswith(
        "arm.ddq is hidden: model.ddq_ref cannot read it (the robot's architecture is closed)"
    )


def test_the_torque_based_framework_that_takes_the_wanted_for_the_measured_acceleration_is_not_proved(
    tmp_path: Path,
) -> None:
    file = changed(
        tmp_path,
        "torque_indirect_pi",
        ("  model.ddq_ref: sensor.ddq_m\n", ""),
        ("  sensor:   {type: accelerometer}\n", ""),
    )
    verdict = verify(Graph.read(file).diagram)
    assert verdict.outcome == "not_applicable"
    assert verdict.reason.startswith("identically zero, so that nothing would be proved: adaptation: epsilon")


def test_the_torque_based_framework_needs_the_bias_for_the_servos_integrator(tmp_path: Path) -> None:
    text = graphs()["torque_direct_pi"].read_text(encoding="utf-8").replace(", bias: true", "")
    lines = [line for line in text.splitlines() if "a_d_hat_box" not in line and not line.startswith("      - [")]
    file = tmp_path / "graph.yaml"
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    verdict = verify(Graph.read(file).diagram)
    assert verdict.outcome == "refuted"


def test_the_direct_adaptation_needs_a_nominal_model(tmp_path: Path) -> None:
    file = changed(tmp_path, "torque_direct_pi", (", nominal: 0.8", ""))
    with pytest.raises(DmframeError) as caught:
        _ = Graph.read(file).diagram
    assert "adaptation.a_d_nominal: expected an output of that name in another block, found none" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "servo", "text"),
    [
        (
            "torque_direct_pid",
            "{type: pi_servo, K_P: [60, 30], K_I: [240, 120]}",
            "pid_torque_inverse expects servo.K_P in V/rad, found V s/rad; it is incompatible with servo (pi_servo)",
        ),
        (
            "torque_direct_pi",
            "{type: pid_servo, K_D: 60, K_P: 180, K_I: 60}",
            "pi_torque_inverse expects servo.K_P in V s/rad, found V/rad; it is incompatible with servo (pid_servo)",
        ),
    ],
)
def test_a_torque_inverse_of_another_servo_is_refused(name: str, servo: str, text: str, tmp_path: Path) -> None:
    lines = graphs()[name].read_text(encoding="utf-8").splitlines()
    wrong = [f"  servo:    {servo}" if line.startswith("  servo:") else line for line in lines]
    file = tmp_path / "graph.yaml"
    file.write_text("\n".join(wrong) + "\n", encoding="utf-8")
    with pytest.raises(DmframeError) as caught:
        _ = Graph.read(file).diagram
    assert str(caught.value).endswith(text)
