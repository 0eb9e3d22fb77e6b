"""A page's simulation, compared with `dmframe run` for the same numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from in_node import answered, content, content_of_graph

import dmframe as dm
from dmframe.common.units import plain
from dmframe.graph.graph import Graph
from dmframe.simulate import Recording, simulate
from dmframe.simulate.start import start_state


def simulated(graph: Graph, seconds: float, **options: Any) -> Recording:
    file = graph.file
    given = {"clock": file.clock, "solver": graph.solver, "start": graph.start} | options
    return simulate(graph.diagram, seconds, **given)


def columns(recording: Recording) -> np.ndarray:
    return np.hstack([recording.states[v.label] for v in recording.diagram.loop.variables])


@pytest.mark.parametrize("name", ["arm2_joint", "pendulum", "ur10_fast"])
def test_a_page_simulates_what_run_does(name: str) -> None:
    (found,) = answered(content(name), runs=[{"horizon": 1.0}])["answers"]
    expected = columns(simulated(dm.load(name), 1.0))[:: found["every"]]
    np.testing.assert_allclose(found["states"], expected[: found["kept"]], rtol=1e-7, atol=1e-9)
    assert found["divergence"] is None
    assert found["notices"] == []


def test_numbers_that_a_slider_moved_give_what_set_gives() -> None:
    data, p = content("arm2_joint"), list(content("arm2_joint")["p"])
    at = next(slider["at"] for slider in data["sliders"] if slider["label"] == "task.alpha_bar")
    p[at] = 3.0
    (found,) = answered(data, runs=[{"p": p, "horizon": 0.5}])["answers"]
    expected = columns(simulated(dm.load("arm2_joint").set({"task.alpha_bar": 3}), 0.5))
    np.testing.assert_allclose(found["states"][-1], expected[-1], rtol=1e-7, atol=1e-9)
    still = columns(simulated(dm.load("arm2_joint"), 0.5))
    assert np.max(np.abs(np.array(found["states"][-1]) - still[-1])) > 1e-5  # the moved number has an effect


def test_a_clock_that_a_slider_moved_gives_what_set_gives() -> None:
    (found,) = answered(content("ur10_fast"), runs=[{"tick": 0.02, "horizon": 1.0}])["answers"]
    expected = columns(simulated(dm.load("ur10_fast").set(clock="20 ms"), 1.0))
    np.testing.assert_allclose(found["states"][-1], expected[-1], rtol=1e-7, atol=1e-9)


def test_a_start_is_put_onto_a_path_that_moved_and_then_shifted() -> None:
    data, p = content("arm2_joint"), list(content("arm2_joint")["p"])
    p[0] += 0.3  # path.center
    found = answered(data, runs=[{"p": p, "horizon": 0.01}, {"p": p, "shift": [0.1, -0.2], "horizon": 0.01}])["answers"]
    graph = dm.load("arm2_joint").set({"path.center": p[:2]})
    place = data["pose"]["at"]
    expected = start_state(graph.diagram, graph.start)
    np.testing.assert_allclose(found[0]["states"][0], expected, atol=1e-8)
    np.testing.assert_allclose(found[1]["start"], expected[place : place + 2] + np.array([0.1, -0.2]), atol=1e-8)


@pytest.fixture(scope="module")
def sought() -> Graph:
    """A robot without a given start pose, which follows from the path of its tool."""
    held = dm.load("ur10_fast_kinematic").set({"start": {"near": [1.5, -1.0, 1.0]}})
    assert held.start == {"near": [1.5, -1.0, 1.0]}
    return held


def test_a_pose_for_a_tools_place_is_found_from_the_files_pose_on(sought: Graph) -> None:
    data = content_of_graph(sought)
    p, far = list(data["p"]), list(data["p"])
    at = next(slider["at"] for slider in data["sliders"] if slider["label"] == "path.center[0]")
    p[at : at + 3] = [p[at] + 0.1, p[at + 1] - 0.1, p[at + 2] + 0.1]
    far[at] += 3.0
    near, away = answered(data, runs=[{"p": p, "horizon": 0.01}, {"p": far, "horizon": 0.01}])["answers"]
    moved = sought.set({"path.center": p[at : at + 3]})
    np.testing.assert_allclose(near["states"][0], start_state(moved.diagram, moved.start), atol=1e-7)
    assert near["notices"] == []
    assert "no pose within the joint limits reaches the start of the path" in away["notices"][0]
    assert np.all(np.array(away["start"]) >= data["pose"]["lower"])
    assert np.all(np.array(away["start"]) <= data["pose"]["upper"])


POSED = """\
dmframe: 1
robot: {model: ur10, tool: ee_link}
clock: 8 ms
duration: 1 s
start: {near: [0.6, -1.5, 2.1, -2.2, -1.6, 0.6]}
blocks:
  goal:        {type: setpoint, x_d: [0.4, 0.5, 0.3], orientation: [0, 90 deg, 0]}
  geometry:    {type: kinematics}
  orientation: {type: tool_orientation, lever: 0.5}
  task:        {type: pose_tracking, gamma: 1}
  inverse:     {type: kinematic_command}
  servo:       {type: pi_servo, K_P: [800, 800, 400, 16, 8, 0.8], K_I: [1760, 1760, 880, 35.2, 17.6, 1.76]}
  arm:         {type: manipulator}
"""


def test_a_page_of_a_pose_starts_with_its_orientation_and_draws_the_turn_in_degrees() -> None:
    data = content_of_graph(dm.load(POSED))
    (group,) = (group for group in data["groups"] if group["kind"] == "turn")
    assert (group["label"], group["unit"], group["size"], group["of"]) == ("task.R_apart", "deg", 1, "shown")
    shifts = [[0.0] * 6, [0.0] * 5 + [np.radians(10)]]  # the last joint turns the tool about its own axis
    still, turned = answered(data, runs=[{"horizon": 0.01, "shift": shift} for shift in shifts])["answers"]
    np.testing.assert_allclose(still["drawn"][group["at"]], 0, atol=1e-5)
    np.testing.assert_allclose(turned["drawn"][group["at"]], 10, atol=1e-5)


def test_a_stiff_plant_gets_the_steps_that_run_takes() -> None:
    data, p = content("ur10_fast"), list(content("ur10_fast")["p"])
    slider = next(slider for slider in data["sliders"] if slider["label"] == "servo.K_D")
    place = slice(slider["at"], slider["at"] + slider["size"])
    p[place] = [20 * number for number in p[place]]
    (found,) = answered(data, runs=[{"p": p, "horizon": 0.08}])["answers"]
    run = simulated(dm.load("ur10_fast").set({"servo.K_D": p[place]}), 0.08)
    assert found["notices"][0] in run.notices
    assert run.solver.step is not None
    assert found["substeps"] == int(np.ceil(0.008 / run.solver.step))
    np.testing.assert_allclose(found["states"][-1], columns(run)[-1], rtol=1e-6, atol=1e-9)


def test_a_run_that_diverges_ends_where_run_states_it_does() -> None:
    data, p = content("arm2_joint"), list(content("arm2_joint")["p"])
    at = next(slider["at"] for slider in data["sliders"] if slider["label"] == "task.alpha_bar")
    p[at] = 200.0
    (found,) = answered(data, runs=[{"p": p}])["answers"]
    run = simulated(dm.load("arm2_joint").set({"task.alpha_bar": 200}), 20.0)
    assert found["divergence"] is not None
    assert found["divergence"] == str(run.divergence)


def test_an_instant_is_kept_at_the_end_and_a_run_too_long_is_cut() -> None:
    data = content("ur10_fast")
    whole, cut = answered(data, runs=[{"horizon": 8.0}, {"horizon": 8.0, "most": 900}])["answers"]
    assert whole["times"][-1] == pytest.approx(8.0)
    assert whole["kept"] == 1001
    assert whole["short"] == 0
    assert cut["short"] == pytest.approx(cut["times"][-1]) == pytest.approx(0.8)


def test_quantities_are_written_as_python_writes_them() -> None:
    values, units = (90e-3, -2.5e-5, 1e10, 0.0, 9996.0, 300.0), ("s", "m", "rad/s", "N m", "m^2", "Hz", "1/s", "")
    pairs = [(value, unit) for value in values for unit in units]
    assert answered({}, quantities=pairs)["plain"] == [plain(*pair) for pair in pairs]
