"""Paths of files: CSV and JointTrajectory, inverse kinematics, rest at the ends, limits, and the block of a graph."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from typer.testing import CliRunner

import dmframe as dm
from dmframe.cli.app import app
from dmframe.common.errors import DmframeError, MissingError, RobotError, ValueFault
from dmframe.design.motion import AGAIN, LONGEST, NEVER, OWN_RATE, TRAINING, own_motion, tool_motion
from dmframe.design.path_block import path_block
from dmframe.design.path_file import PathFile, read_path
from dmframe.design.points import ACCELERATION, Points, followed_by, points_of
from dmframe.design.tool_path import Kinematics, followed
from dmframe.graph.first import first_graph
from dmframe.robot.chain import SerialChain, pin_configuration
from dmframe.robot.library import load

NEAR = np.array([0.0, -1.2, 1.3, -1.2, -1.5, 0.2])


@pytest.fixture(scope="module")
def arm() -> SerialChain:
    return load("ur5e")


def waves(t: np.ndarray) -> np.ndarray:
    return NEAR + 0.1 * (1 - np.cos(2 * np.pi * t / 6))[:, None] * np.arange(1, 7) / 6


def csv(path: Path, names: list[str], *columns: Any) -> Path:
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=",".join(names), comments="")
    return path


def pose(chain: SerialChain, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position and orientation of the tool, by Pinocchio."""
    data = chain.model.createData()
    pin.framesForwardKinematics(chain.model, data, pin_configuration(chain, q))
    placement = data.oMf[chain.model_tool]
    return placement.translation.copy(), placement.rotation.copy()


def message(**more: Any) -> dict[str, Any]:
    names = ["finger", *load("ur5e").joint_names[::-1]]
    points = [
        {"positions": [0.7, *NEAR[::-1]], "time_from_start": {"sec": 1, "nanosec": 0}},
        {"positions": [0.7, *(NEAR + 0.1)[::-1]], "time_from_start": {"sec": 3, "nanosec": 500_000_000}},
    ]
    return {"joint_names": names, "points": points} | more


@pytest.mark.parametrize("names", ["names", "q_1", "q_0", "degrees"])
def test_columns_of_joints_have_their_names_or_numbers(names: str, tmp_path: Path, arm: SerialChain) -> None:
    t = np.linspace(2, 8, 61)
    heads, scale = [*arm.joint_names], 1.0
    if names in ("q_1", "q_0"):
        heads = [f"q_{int(names[-1]) + k}" for k in range(6)]
    elif names == "degrees":
        heads, scale = [f"{name}_deg" for name in arm.joint_names], 180 / np.pi
    found = read_path(csv(tmp_path / "p.csv", ["time", *heads], t, scale * waves(t)), arm)
    assert found.kind == "joints"
    np.testing.assert_allclose(found.times, t - 2)
    np.testing.assert_allclose(found.rows, waves(t), atol=1e-12)


def test_a_quaternion_is_the_rotation_vector_of_the_same_orientation(tmp_path: Path, arm: SerialChain) -> None:
    R = pin.exp3(np.array([0.3, -0.4, 0.5]))
    t, x = np.arange(3.0), np.array([[0.5, 0, 0.3], [0.5, 0.1, 0.3], [0.5, 0.1, 0.4]])
    quaternion = np.tile(pin.Quaternion(R).coeffs(), (3, 1))
    found = read_path(csv(tmp_path / "p.csv", ["t", "x", "y", "z", "qx", "qy", "qz", "qw"], t, x, quaternion), arm)
    assert found.kind == "pose"
    np.testing.assert_allclose(found.rows[:, 3:], np.tile([0.3, -0.4, 0.5], (3, 1)), atol=1e-9)
    assert read_path(csv(tmp_path / "x.csv", ["t", "x", "y", "z"], t, x), arm).kind == "position"


@pytest.mark.parametrize("key", ["", "joint_trajectory", "goal"])
def test_a_joint_trajectory_is_ordered_by_the_names_of_the_joints(key: str, tmp_path: Path, arm: SerialChain) -> None:
    given = {"": message(), "joint_trajectory": {"joint_trajectory": message()}}
    given["goal"] = {"goal": {"trajectory": message()}}
    (tmp_path / "p.json").write_text(json.dumps(given[key]))
    found = read_path(tmp_path / "p.json", arm)
    np.testing.assert_allclose(found.rows, [NEAR, NEAR + 0.1])
    np.testing.assert_allclose(found.times, [0, 2.5])
    assert "finger" in found.notes[0]


def test_yaml_of_ros_1_and_numbers_of_seconds_are_read(tmp_path: Path, arm: SerialChain) -> None:
    names = ", ".join(arm.joint_names)
    (tmp_path / "p.yaml").write_text(
        f"joint_names: [{names}]\npoints:\n- positions: {NEAR.tolist()}\n  time_from_start: {{secs: 0, nsecs: 0}}\n"
        f"- positions: {(NEAR + 0.2).tolist()}\n  time_from_start: 2.5\n---\n"
    )
    np.testing.assert_allclose(read_path(tmp_path / "p.yaml", arm).times, [0, 2.5])


def test_points_with_velocities_are_met_with_them(tmp_path: Path, arm: SerialChain) -> None:
    zero, moving = [0.0] * 7, [0.05] * 7
    points = [
        {"positions": [0.0] + [0.1 * k] * 6, "velocities": v, "time_from_start": 2.0 * k}
        for k, v in enumerate((zero, moving, zero))
    ]
    (tmp_path / "p.json").write_text(json.dumps(message(points=points)))
    found, h = points_of(read_path(tmp_path / "p.json", arm), arm, NEAR), 1e-4
    q = followed_by(found, np.array([2 - h, 2, 2 + h]))
    np.testing.assert_allclose(q[1], 0.1, atol=2e-5)
    np.testing.assert_allclose((q[2] - q[0]) / (2 * h), 0.05, atol=2e-4)


BAD_TABLES = [
    ("", "empty"),
    ("a,b\n1,2\n", "column t"),
    ("t,x,y\n0,1,2\n1,2,3\n", "x, y, z"),
    ("t,x,y,z\n0,1,2,3\n", "at least 2 points"),
    ("t,x,y,z\n0,.5,0,.3\n0,.5,.1,.3\n", "increasing times"),
    ("t,x,y,z\n0,.5,0,.3\n1,nan,.1,.3\n", "finite"),
    ("t,x,y,z\n0,.5,0,.3\n1,.5,0,.3\n", "a path that moves"),
    ("t,x,y,z\n0,.5,0,oops\n1,.5,0,.3\n", "oops"),
    ("t,x,y,z,qx,qy,qz,qw\n0,.5,0,.3,0,0,0,2\n1,.5,.1,.3,0,0,0,1\n", "length 1"),
]


@pytest.mark.parametrize(("text", "found"), BAD_TABLES)
def test_a_table_without_a_path_is_refused(text: str, found: str, tmp_path: Path, arm: SerialChain) -> None:
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(DmframeError, match=found):
        read_path(tmp_path / "p.csv", arm)


BAD_MESSAGES = [
    ("[1, 2]", "no mapping"),
    ("{", "YAML or JSON"),
    ("{}", "joint_names and points"),
    (json.dumps(message(joint_names=["a", "b"])), "missing: shoulder_pan_joint"),
    (json.dumps(message(points=[{"positions": [1]}])), "time_from_start"),
    (json.dumps(message(points=[{"positions": [1.0], "time_from_start": 0}] * 2)), "expected 7 numbers"),
    (json.dumps(message(points=[{"positions": ["a"] * 7, "time_from_start": 0}] * 2)), "expected 7 numbers"),
    (json.dumps(message(points=[{"time_from_start": 0}, {"time_from_start": 1}])), "positions in each point"),
]


@pytest.mark.parametrize(("text", "found"), BAD_MESSAGES)
def test_a_message_without_a_path_is_refused(text: str, found: str, tmp_path: Path, arm: SerialChain) -> None:
    (tmp_path / "p.json").write_text(text)
    with pytest.raises(DmframeError, match=found):
        read_path(tmp_path / "p.json", arm)


def test_a_folder_and_a_missing_file_are_refused(tmp_path: Path, arm: SerialChain) -> None:
    for path in (tmp_path, tmp_path / "none.csv"):
        with pytest.raises(MissingError, match="the file of a path"):
            read_path(path, arm)


@pytest.mark.parametrize("turns", [False, True])
def test_inverse_kinematics_reach_each_pose(turns: bool, arm: SerialChain) -> None:
    kinematics, s = Kinematics(arm, turns=turns), np.linspace(0, 2 * np.pi, 60)
    start = kinematics.pose(NEAR)
    goals = np.tile(start, (60, 1))
    goals[:, :3] += 0.08 * np.column_stack([np.sin(s), 1 - np.cos(s), 0 * s])
    found = followed(kinematics, goals, NEAR)
    for goal, q in zip(goals, found, strict=True):
        x, R = pose(arm, q)
        np.testing.assert_allclose(x, goal[:3], atol=2e-6)
        if turns:
            np.testing.assert_allclose(R, pin.exp3(goal[3:]), atol=2e-5)
    np.testing.assert_allclose(found[-1], found[0], atol=1e-4)  # a redundant arm comes back, too


def test_a_path_out_of_reach_or_for_too_few_joints_is_refused(arm: SerialChain) -> None:
    far = np.array([[2.0, 0, 0.3, 0, 0, 0], [2.0, 0.1, 0.3, 0, 0, 0]])
    with pytest.raises(RobotError, match="point 1 is out of reach"):
        followed(Kinematics(arm, turns=False), far, NEAR)
    leaving = np.linspace(Kinematics(arm, turns=False).pose(NEAR), [1.5, 0, 0.3, 0, 0, 0], 50)
    with pytest.raises(RobotError, match=r"singular|out of reach"):
        followed(Kinematics(arm, turns=False), leaving, NEAR)
    with pytest.raises(RobotError, match=r"at least 6 joints.*--task position"):
        Kinematics(load("so101"), turns=True)


def of_joints(t: np.ndarray, q: np.ndarray) -> PathFile:
    return PathFile("made", "joints", t, q)


def test_a_path_that_starts_with_a_velocity_is_passed_more_slowly_at_its_ends(arm: SerialChain) -> None:
    t = np.linspace(0, 8, 161)
    q = NEAR + 0.05 * t[:, None]
    found = points_of(of_joints(t, q), arm, NEAR)
    assert "more slowly for 1 s" in found.notes[0]
    assert found.times[-1] == pytest.approx(9.0)
    fine = np.linspace(0, 9, 9001)
    path = followed_by(found, fine)
    rates = np.gradient(path, fine, axis=0)
    assert np.max(np.abs(rates[[0, -1]])) < 1e-3
    np.testing.assert_allclose(path[[0, -1]], q[[0, -1]], atol=1e-6)
    np.testing.assert_allclose(rates[4500], 0.05, rtol=2e-2)


def test_the_block_follows_the_file_within_the_stated_deviation(arm: SerialChain) -> None:
    t = np.linspace(0, 6, 301)
    found = points_of(of_joints(t, waves(t)), arm, NEAR)
    assert found.after == "repeats"
    assert found.deviation <= 2e-4
    np.testing.assert_allclose(followed_by(found, t), waves(t), atol=1.1 * found.deviation)


@pytest.mark.parametrize(
    ("robot", "rate", "change", "text"),
    [
        ("ur5e", 0.1, 9.0, "leaves the range of shoulder_pan_joint, -6.283 to 6.283 rad: 9 rad after 31.4 s"),
        ("ur5e", 9.0, 0.5, r"requires of shoulder_pan_joint an acceleration of .*: pass it in 3.9\d times its time"),
        (
            "gen3",
            0.7,
            4.5,
            r"requires of joint_1 a velocity of .*, whose limit is .*: pass it in 1\.\d+ times its time",
        ),
    ],
)
def test_a_path_beyond_the_limits_is_refused_with_a_remedy(robot: str, rate: float, change: float, text: str) -> None:
    chain, t = load(robot), np.linspace(0, 2 * np.pi / rate, 400)
    q = np.zeros((400, chain.n)) + 0.1
    q[:, 0] = change * (1 - np.cos(rate * t)) / 2
    with pytest.raises(RobotError, match=text):
        points_of(of_joints(t, q), chain, q[0])


def test_a_path_of_the_users_own_is_judged_and_one_passed_more_slowly_is_trained(arm: SerialChain) -> None:
    t = np.linspace(0, 6, 121)
    motion = own_motion(points_of(of_joints(t, waves(t)), arm, NEAR), "joints")
    assert motion.handed == OWN_RATE
    own, trained = motion.paths[OWN_RATE], motion.paths[TRAINING]
    np.testing.assert_allclose(np.array(trained["times"]) / own["times"][-1], 1.25 * np.array(own["times"]) / 6)
    assert trained["q_d"] == own["q_d"]
    assert own["repeats"] == pytest.approx(2 * np.pi / 6, rel=1e-5)
    slow = Points(np.array([0.0, LONGEST]), waves(t)[[0, 30]], np.zeros((2, 6)), np.zeros((2, 6)), 0.0)
    with pytest.raises(RobotError, match="240 s there and back"):
        own_motion(slow, "joints")


def test_paths_of_the_tool_are_closed_and_within_the_acceleration(tmp_path: Path) -> None:
    first = first_graph("so101", tmp_path)
    chain = load("so101")
    motion = tool_motion(first, chain, turns=False)
    assert (motion.error, set(motion.paths)) == ("tool", {TRAINING, AGAIN, NEVER})
    for path in motion.paths.values():
        assert path["type"] == "joint_waypoints"
        assert path["q_d"][0] == path["q_d"][-1]
        np.testing.assert_allclose(path["q_d"][0], motion.start, atol=1e-5)
        table = [np.array(path[key]) for key in ("times", "q_d", "dq_d", "ddq_d")]
        t = np.linspace(0, table[0][-1], 4001)
        q = followed_by(Points(*table, 0.0), t)
        assert np.max(np.abs(np.gradient(np.gradient(q, t, axis=0), t, axis=0)[3:-3])) < ACCELERATION
        x = np.array([pose(chain, row)[0] for row in q[::40]])
        assert np.ptp(x, axis=0).max() > 0.02


def test_the_command_writes_a_path_that_a_graph_follows(tmp_path: Path) -> None:
    t, chain = np.linspace(0, 3, 61), load("arm2")
    q = np.array([0.5, 0.9]) + np.outer((1 - np.cos(np.pi * t / 3)) / 2, [0.2, -0.3])
    csv(tmp_path / "p.csv", ["t", *chain.joint_names], t, q)
    graph = tmp_path / "g.yaml"
    graph.write_text(dm.load("arm2_joint").text)
    found = CliRunner().invoke(app, ["path", str(tmp_path / "p.csv"), str(graph), "--after", "returns"])
    assert found.exit_code == 0, found.output
    block = path_block(tmp_path / "p.csv", str(graph), after="returns")
    run = dm.load(str(graph)).set({"blocks.path": dict(block.block), "start": dict(block.start)}).run(until=6.0)
    label = "path.q_d"
    np.testing.assert_allclose(run[label][np.searchsorted(run.time, 3.0)], q[-1], atol=1e-4)
    np.testing.assert_allclose(run[label][-1], q[0], atol=1e-4)
    fast = csv(tmp_path / "fast.csv", ["t", *chain.joint_names], t / 3, q)  # 1.3 rad/s^2 is a limit of designs alone
    assert path_block(fast, str(graph)).block["times"][-1] == pytest.approx(1.0)
    with pytest.raises(ValueFault, match="stays or returns"):
        path_block(tmp_path / "p.csv", str(graph), after="repeats")
    assert "found always" in CliRunner().invoke(app, ["path", "a.csv", "ur5e", "--after", "always"]).exception.args[0]  # type: ignore[union-attr]


def test_a_path_of_the_tool_is_a_block_of_tool_points_or_of_joints(tmp_path: Path, arm: SerialChain) -> None:
    x, R = pose(arm, NEAR)
    t = np.linspace(0, 4, 81)
    places = x + 0.05 * (1 - np.cos(np.pi * t / 2))[:, None] * np.array([0, 1, 0])
    file = csv(tmp_path / "x.csv", ["t", "x", "y", "z"], t, places)
    assert path_block(file, "ur10_fast").block["type"] == "waypoints"
    assert np.array(path_block(file, "ur10_fast").block["x_d"])[0] == pytest.approx(x, abs=1e-6)
    found = path_block(file, "ur5e", joints=True)
    assert found.block["type"] == "joint_waypoints"
    np.testing.assert_allclose(pose(arm, np.array(found.start["q"]))[0], x, atol=1e-5)
    turned = csv(tmp_path / "p.csv", ["t", "x", "y", "z", "rx", "ry", "rz"], t, places, np.tile(pin.log3(R), (81, 1)))
    with pytest.raises(ValueFault, match="--joints"):
        path_block(turned, "ur5e")
