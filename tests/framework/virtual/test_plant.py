"""The plant behind the manufacturer's interface, compared with the simulation."""

from __future__ import annotations

import numpy as np
import pytest
from virtual_robots import graph, robot

from dmframe.common.errors import DmframeError
from dmframe.export.robot import robot_of
from dmframe.virtual.plant import Plant


def followed(plant: Plant, commands: np.ndarray) -> np.ndarray:
    rows = [plant.q.copy()]
    for command in commands:
        assert plant.move(command)
        rows.append(plant.q.copy())
    return np.array(rows)


@pytest.mark.parametrize(("engine", "ticks"), [("compiled", 250), ("interpreted", 25)])
def test_it_moves_as_the_simulation_does(engine: str, ticks: int) -> None:
    held = graph("ur10_fast")
    run = held.run(ticks * 0.008, progress=False).recording
    plant = Plant(held, 0.008, engine=engine)  # type: ignore[arg-type]
    assert plant.engine == engine
    found = followed(plant, run["inverse.dq_c"][:ticks])
    assert np.max(np.abs(found - run["arm.q"][: ticks + 1])) < 1e-14


def test_another_arm_would_be_noticed() -> None:
    held = graph("ur10_fast")
    run = held.run(0.8, progress=False).recording
    other = held.set({"arm.viscous": [5, 5, 2.01]})
    found = followed(Plant(other, 0.008), run["inverse.dq_c"][:100])
    assert np.max(np.abs(found - run["arm.q"][:101])) > 1e-8


def test_a_graph_has_one_robot_and_a_changed_graph_another() -> None:
    held = graph("ur10_fast")
    one, other = robot_of(held), robot_of(held.set({"arm.viscous": [5, 5, 2.01], "start.q": [1.45, -1.01, 0.97]}))
    assert robot_of(held) is one
    values = [{member.label: member.value for member in each.parameters} for each in (one, other)]
    assert values[0]["arm.viscous"] != values[1]["arm.viscous"]
    assert one.states != other.states


def test_a_shorter_cycle_takes_the_same_steps() -> None:
    held = graph("ur10_fast")
    slow, fast = (Plant(held, cycle) for cycle in (0.008, 0.002))
    command = np.array([0.1, -0.1, 0.2])
    assert slow.move(command)
    for _ in range(4):
        assert fast.move(command)
    assert fast.q.tobytes() == slow.q.tobytes()


def test_a_cycle_that_no_step_divides_is_cut_into_shorter_ones() -> None:
    held = graph("ur10_fast")
    plant = Plant(held, 0.0025)
    assert (plant.steps, plant.step) == (3, 0.0025 / 3)


def test_what_is_not_finite_moves_nothing() -> None:
    held = graph("ur10_fast")
    plant = Plant(held, 0.002)
    before = plant.q.copy()
    assert not plant.move(np.array([np.nan, 0, 0]))
    assert np.array_equal(plant.q, before)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("panda_full", "expected a UR"),
        ("ur10_fast_position", "expected joint velocity commands"),
        ("theorem_1", "found continuous"),
        ("pendulum", "expected a UR"),
    ],
)
def test_a_robot_that_is_not_a_closed_ur_is_refused(name: str, text: str) -> None:
    with pytest.raises(DmframeError, match=text):
        robot(name)


def test_three_joints_have_their_places_among_six() -> None:
    held = robot("ur10_fast")
    assert held.q.tolist() == [1.455411, -1.016031, 0.978316, 0.0, -np.pi / 2, 0.0]
    chain = held.arm.chain
    assert [chain.joint_names[k] for k in range(3)] == ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"]
    assert held.arm.velocity.tolist() == [2.16, 2.16, 3.15, np.inf, np.inf, np.inf]


def test_the_flange_is_where_the_graph_has_it_turned_by_pi() -> None:
    held = robot("ur10_fast")
    x = held.arm.pose(held.q)[:3]
    run = graph("ur10_fast").run(0.008, progress=False).recording
    assert np.allclose(x * [-1, -1, 1], run["arm.x"][0], atol=1e-9)


def test_inverse_kinematics_come_back_to_the_pose() -> None:
    held = robot("ur10_full")
    pose = held.arm.pose(held.q) + np.array([0.02, -0.03, 0.01, 0.05, 0.02, -0.04])
    q = held.arm.inverse(pose, held.q)
    assert np.allclose(held.arm.pose(q), pose, atol=1e-8)
    step = 1e-6
    for k in range(6):  # and the Jacobian belongs to the position of the pose
        ahead = q + step * np.eye(6)[k]
        slope = (held.arm.pose(ahead)[:3] - held.arm.pose(q)[:3]) / step
        assert np.allclose(held.arm.jacobian(q)[:3, k], slope, atol=1e-5)
    with pytest.raises(DmframeError, match="only 3 free joints"):
        robot("ur10_fast").arm.inverse(pose, q)
