from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import dmframe as dm
from dmframe.results.metrics import eighth_of, euclidean, rms_by_eighth, tracking_error, turn_error
from dmframe.results.summary import summary


def test_rms_of_a_staircase_is_each_of_its_steps():
    times = np.arange(8001) * 0.001
    assert rms_by_eighth(times, np.minimum(np.floor(times + 1e-12), 7.0), 8.0) == tuple(float(k) for k in range(8))


def test_rms_of_a_sine_over_whole_periods_is_its_amplitude_over_root_two():
    times = np.arange(80_000) * 1e-3
    for value in rms_by_eighth(times, np.abs(3.0 * np.sin(2 * np.pi * times)), 80.0):
        assert value == pytest.approx(3.0 / np.sqrt(2), rel=1e-9)


def test_eighths_are_of_the_planned_duration_and_those_never_reached_are_none():
    times = np.arange(250) * 0.01  # 2.5 s of 8 s
    assert rms_by_eighth(times, np.ones(250), 8.0) == (1.0, 1.0, 1.0, None, None, None, None, None)


def test_an_instant_that_opens_an_eighth_is_not_counted_before_it():
    times = np.arange(8 * 3 + 1) * 0.1  # 0.3 and 0.6 are not exact floats
    counts = [int(np.sum(np.floor(times * 8 / 2.4 + 1e-9).astype(int).clip(0, 7) == k)) for k in range(8)]
    norm = (np.arange(times.size) // 3).clip(0, 7).astype(float)
    assert counts == [3] * 7 + [4]
    assert rms_by_eighth(times, norm, 2.4) == tuple(map(float, range(8)))


def test_the_mean_of_what_is_not_a_number_is_none() -> None:
    times = np.arange(16) / 2
    for bad in (np.nan, np.inf):
        found = rms_by_eighth(times, np.where(times == 2.5, bad, 1.0), 8.0)
        assert found == (1.0, 1.0, None, 1.0, 1.0, 1.0, 1.0, 1.0)
        assert not np.isfinite(euclidean(np.array([[bad, 1.0]]))[0])


def test_norms_of_numbers_whose_squares_overflow_are_right():
    assert euclidean(np.array([[3e200, 4e200], [0.0, 0.0]])) == pytest.approx([5e200, 0.0])


def test_the_error_is_actual_minus_desired_with_the_unit_of_the_signal(ur10):
    error = tracking_error(ur10.recording)
    assert (error.signal, error.unit) == ("x - x_d", "m")
    assert np.array_equal(error.values, ur10.recording["arm.x"] - ur10.recording["path.x_d"])
    assert error.norm == pytest.approx(np.linalg.norm(error.values, axis=1))
    assert error.rms_final == error.rms_by_eighth[-1]


def test_a_synthetic_constant_error_has_its_length_as_rms(arm2):
    states = dict(arm2.recording.states) | {"arm.q": arm2.recording["path.q_d"] + np.array([3.0, -4.0])}
    error = tracking_error(replace(arm2.recording, states=states))
    assert error.signal == "q - q_d"
    assert error.rms_by_eighth == pytest.approx([5.0] * 8)


def test_the_summary_is_valid_json_with_null_for_what_is_not_there(ur10, blow_up):
    data = json.loads(json.dumps(summary("a", blow_up(ur10.recording, 0.4), "out"), allow_nan=False))
    assert list(data) == [
        "graph", "duration", "clock", "diverged", "divergence", "interrupted", "error", "turn", "rank", "shown",
        "engine", "solver", "wall_time", "real_time_factor", "notices", "out",
    ]  # fmt: skip
    assert list(data["error"]) == ["signal", "unit", "rms_by_eighth", "rms_final"]
    assert (data["diverged"], data["clock"], data["error"]["rms_final"]) == (True, 0.008, None)
    assert "arm.q[0] is no longer finite" in data["divergence"]


def test_a_tools_rotation_error_is_given_in_degrees_next_to_its_position_error(ur10):
    count = len(ur10.recording.time)
    angle = np.linspace(0, np.pi, count)  # to half a turn
    turns = np.array([pin.exp3(a * np.array([0.6, 0, 0.8])) for a in angle])
    outputs = {**ur10.recording.outputs, "task.R_apart": np.sum((turns - np.eye(3)) ** 2, axis=(1, 2))[:, None]}
    assert turn_error(ur10.recording) is None
    assert summary("a", ur10.recording)["turn"] is None
    turned = replace(ur10.recording, outputs=outputs, diagram=dm.load("ur10_pose").diagram)
    found = turn_error(turned)
    np.testing.assert_allclose(found.angle, np.degrees(angle), atol=1e-5)
    last = np.degrees(angle)[eighth_of(found.times, turned.duration) == 7]
    assert found.rms_final == pytest.approx(np.sqrt(np.mean(last**2)))
    assert "deg" in repr(found)


def test_a_summary_of_a_run_that_took_no_time_has_no_factor(pendulum):
    data = summary("a", replace(pendulum.recording, wall_time=0.0))
    assert (data["real_time_factor"], data["clock"], data["out"]) == (None, "continuous", None)


INERTIAL = '<inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
SLIDING = """dmframe: 1
robot: made.urdf
clock: 8 ms
duration: 800 ms
start: {{q: {start}}}
blocks:
  path:    {{type: setpoint, q_d: {goal}}}
  task:    {{type: joint_tracking, alpha_bar: 1}}
  inverse: {{type: kinematic_command}}
  servo:   {{type: pid_servo, K_D: 100, K_P: 100, K_I: 100}}
  arm:     {{type: manipulator, viscous: 1}}
"""


def sliding_robot(folder: Path, *kinds: str) -> dm.Graph:
    """A robot with joints about or along z, whose gravity torque is zero except for the last direction."""
    text = '<robot name="made"><link name="l0"/>'
    for k, kind in enumerate(kinds, 1):
        text += (
            f'<link name="l{k}">{INERTIAL}</link><joint name="j{k}" type="{kind}"><parent link="l{k - 1}"/>'
            f'<child link="l{k}"/><origin xyz="0.2 0 0"/><axis xyz="0 0 1"/>'
            '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
        )
    (folder / "made.urdf").write_text(f"{text}</robot>")
    path = folder / "sliding.yaml"
    zeros, goal = [0.0] * len(kinds), [0.01 * (k + 1) for k in range(len(kinds))]
    path.write_text(SLIDING.format(start=zeros, goal=goal))
    return dm.load(path)


def test_angles_and_lengths_have_errors_of_their_own(tmp_path):
    graph = sliding_robot(tmp_path, "revolute", "prismatic", "revolute")
    run = graph.run()
    error, values = run.error, (run["arm.q"] - run["path.q_d"]).values
    assert (error.unit, error.prismatic.unit) == ("rad", "m")
    np.testing.assert_allclose(error.norm, np.hypot(values[:, 0], values[:, 2]), atol=1e-15)
    found = rms_by_eighth(run.recording.time, np.abs(values[:, 1]), 0.8)
    assert error.prismatic.rms_by_eighth == pytest.approx(found)
    assert re.search(r"m?rad, [\d.]+ mm", str(run))
    data = summary(graph.name, run.recording)["error"]
    assert data["prismatic"]["unit"] == "m"
    assert data["prismatic"]["rms_final"] == pytest.approx(found[-1])
    swept = dm.sweep(graph, {"task.alpha_bar": [1.0, 2.0]})["rms_final"]
    assert swept.attrs["units"] == "rad"
    assert float(swept[0]) == pytest.approx(error.rms_final, rel=1e-9)


def test_the_error_of_prismatic_joints_alone_is_in_metres(tmp_path):
    run = sliding_robot(tmp_path, "prismatic", "prismatic").run()
    assert (run.error.unit, run.error.prismatic) == ("m", None)
    assert run.error.norm == pytest.approx(np.linalg.norm(run.error.values, axis=1))
