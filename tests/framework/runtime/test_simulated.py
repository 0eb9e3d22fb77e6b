"""A graph's own robot behind a driver's interface equals the simulation."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from drivers import driven, simulated

import dmframe as dm
from dmframe.common.errors import DriveError
from dmframe.runtime.driving import DriveResult
from dmframe.runtime.robot import Sample
from dmframe.runtime.signals import measured_as
from dmframe.simulate import Recording

GCC = shutil.which("gcc")
PLAIN = "-ffp-contract=off -fno-tree-vectorize"


def same_bits(found: DriveResult, graph: dm.Graph, run: Recording) -> None:
    journal = found.journal
    assert found.stop is None
    assert journal["reference"].tobytes() == np.ascontiguousarray(run.time).tobytes()
    for label, name in measured_as(graph.diagram).items():
        assert journal[name].tobytes() == np.ascontiguousarray(run[label]).tobytes(), label
    assert journal["command"].tobytes() == np.ascontiguousarray(run[graph.diagram.loop.commanded[0].name]).tobytes()
    assert journal["sent"].tobytes() == journal["command"].tobytes()
    states = {name.removeprefix("state:") for name in journal.columns.widths if name.startswith("state:")}
    for label in states & run.states.keys():
        assert journal[f"state:{label}"].tobytes() == np.ascontiguousarray(run[label]).tobytes(), label


@pytest.mark.parametrize("name", ["ur10_fast", "ur10_full", "joint_tracking_pi", "observed_tracking_pi"])
def test_driven_it_has_the_bits_of_the_run(name: str) -> None:
    graph, ticks = dm.load(name), 60
    assert graph.clock is not None
    run = graph.run(ticks * graph.clock, engine="interpreted", progress=False).recording
    same_bits(driven(graph, simulated(graph), ticks), graph, run)


@pytest.mark.skipif(GCC is None, reason="needs gcc")
def test_so_has_machine_code_without_fused_operations(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", f"{GCC} {PLAIN}")
    graph, ticks = dm.load("joint_tracking_pi"), 250
    assert graph.clock is not None
    run = graph.run(ticks * graph.clock, engine="compiled", progress=False).recording
    robot = simulated(graph, "compiled")
    found = driven(graph, robot, ticks, engine="compiled")
    assert (robot.engine, run.engine) == ("compiled", "compiled")
    same_bits(found, graph, run)


def test_so_has_a_robot_that_is_not_ideal_with_its_noise_and_its_jitter() -> None:
    graph = dm.load("ur10_fast").reality({"like": "ur", "encoder": {"noise": 1e-5}}).set(jitter="1 ms", seed=5)
    run = graph.run("0.32 s", engine="interpreted", progress=False).recording
    assert not np.allclose(np.diff(run.time), 0.008)
    same_bits(driven(graph, simulated(graph), 40), graph, run)


def test_a_delay_of_whole_samples_holds_commands_back() -> None:
    graph = dm.load("ur10_fast")
    robot = simulated(graph, delay=2)
    assert robot.name == "sim:2"
    at = [robot.read().q_c]
    for _ in range(4):
        robot.command(np.array([0.1, 0, -0.1]))
        at.append(robot.read().q_c)
    moved = np.array(at) - at[0]
    np.testing.assert_array_equal(moved[:3], 0)
    np.testing.assert_allclose(moved[3:], np.outer([1, 2], [0.0008, 0, -0.0008]), atol=1e-15)
    assert robot.read().age == pytest.approx(0.016)


def test_lost_samples_are_counted_and_the_robot_goes_on_meanwhile() -> None:
    robot = simulated(dm.load("ur10_fast"), lost=0.3, seed=1)
    samples = [robot.read() for _ in range(200)]
    steps = np.diff([sample.time for sample in samples]) / robot.period
    np.testing.assert_allclose(steps, [1 + sample.missed for sample in samples[1:]])
    assert 0.2 < 1 - 200 / (samples[-1].time / robot.period + 1) < 0.4


def test_a_payload_is_the_loaded_robot_of_the_catalogue() -> None:
    graph = dm.load("ur10_fast")
    other = graph.reality({"loaded_manipulator": {"payload": [2], "payload_at": [0]}})
    robots = [simulated(graph, payload=2.0), simulated(other), simulated(graph)]
    for _ in range(20):
        for robot in robots:
            robot.command(np.array([0.1, 0.2, -0.1]))
        loaded, catalogue, light = (robot.read().q for robot in robots)
    np.testing.assert_allclose(loaded, catalogue, atol=1e-9)
    assert np.max(np.abs(loaded - light)) > 1e-6


def test_a_move_comes_to_rest_at_the_pose_and_keeps_its_limits() -> None:
    graph = dm.load("ur10_fast")
    robot = simulated(graph)
    begin = robot.read()
    goal = begin.q + np.array([0.3, -0.2, 0.05])
    robot.move(goal, 0.25, 1.0, lambda _: False)
    there = robot.read()
    np.testing.assert_allclose(there.q_c, goal, atol=2e-6)
    assert 0.3 / 0.25 < there.time - begin.time < 0.3 / 0.25 + 2


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("pd_torque", "expected a graph whose only command is the joint velocities"),
        ("ur10_fast_position", "found command.q_t [rad] and inverse.dq_c [rad/s]"),
    ],
)
def test_graphs_that_command_something_else_are_refused(name: str, text: str) -> None:
    graph = dm.load(name).set(clock="2 ms")
    with pytest.raises(DriveError) as raised:
        simulated(graph)
    assert text in str(raised.value)


def test_on_its_way_to_a_pose_it_stops_where_what_watches_reports_it() -> None:
    robot = simulated(dm.load("ur10_fast"))
    first, seen = robot.read(), list[Sample]()
    robot.move(first.q + 1.0, 0.25, 1.0, lambda sample: seen.append(sample) is None and len(seen) == 100)
    assert np.all(robot.read().q < first.q + 0.25 * 100 * robot.period)
    robot.stop(2.0)
    for _ in range(200):
        last = robot.read()
    assert np.abs(last.dq).max() < 1e-3
    assert np.all(last.q < first.q + 0.5)
