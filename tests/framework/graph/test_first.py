"""First graphs of robots: each runs and is proved without an edit, or one sentence names what is missing."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import dmframe as dm
from dmframe.cli.catalogue import new
from dmframe.common.errors import DmframeError, RobotError, UnknownNameError
from dmframe.graph.first import first_graph, is_robot
from tests.random_chains import random_chain

LIMIT = '<limit lower="-2.5" upper="2.5" velocity="3" effort="50"/>'


def made(tmp_path: Path, name: str, tool: str | None = None, hold: dict[str, float] | None = None) -> dm.Graph:
    first = first_graph(name, tmp_path, tool, hold)
    for file, text in first.robot.items():
        (tmp_path / file).write_text(text)
    path = tmp_path / "first.yaml"
    path.write_text(first.text)
    return dm.load(path)


def chain_file(folder: Path, kinds: str, seed: int) -> Path:
    """A robot with random proportions: R a revolute joint, P a prismatic one, C without limits, - without inertia."""
    random = np.random.default_rng(seed)
    text, scale = '<robot name="made"><link name="l0"/>', 10.0 ** random.uniform(-1, 1)
    for k, kind in enumerate(kinds.replace("-", ""), 1):
        mass, length = scale * random.uniform(0.3, 1.0) / k, random.uniform(0.1, 0.4)
        moment = mass * length**2 / 6
        way = random.choice(["1 0 0", "0 1 0", "0 0 1"])
        word, limit = {
            "R": ("revolute", LIMIT),
            "P": ("prismatic", LIMIT.replace("2.5", "0.2")),
            "C": ("continuous", '<limit velocity="3" effort="50"/>'),
        }[kind]
        inertial = (
            f'<inertial><origin xyz="{length / 2} 0.01 0.02"/><mass value="{mass}"/><inertia ixx="{moment}" '
            f'iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"/></inertial>'
        )
        text += (
            f'<link name="l{k}">{"" if "-" in kinds else inertial}</link><joint name="j{k}" type="{word}">'
            f'<parent link="l{k - 1}"/><child link="l{k}"/><origin xyz="{length} 0 {length / 3}"/>'
            f'<axis xyz="{way}"/>{limit}</joint>'
        )
    path = folder / "made.urdf"
    path.write_text(f"{text}</robot>")
    return path


def sound(graph: dm.Graph) -> None:
    run = graph.run(until=4.0, judge=False)
    assert run.divergence is None
    assert graph.verify().outcome == "proved"


def error(graph: dm.Graph) -> float:
    """Root mean square of the joint errors over the last third of 15 s [rad]."""
    run = graph.run(until=15.0, judge=False)
    found = (run["arm.q"] - run["path.q_d"]).values
    return float(np.sqrt(np.mean(np.sum(found[2 * len(found) // 3 :] ** 2, axis=1))))


@pytest.mark.parametrize("name", ["ur10e", "so101", "arm3"])
def test_the_first_graph_of_a_packaged_robot_runs_and_is_proved(tmp_path, name):
    graph = made(tmp_path, name)
    sound(graph)
    for joint, q in zip(graph.robot.joints, graph.start["q"], strict=True):
        assert joint.lower < q < joint.upper


@pytest.mark.parametrize(
    ("kinds", "seed"), [("RRPC", 0), ("RRRR", 1), ("RCRRR", 2), ("PRRRRR", 3), ("RRRR-", 4), ("RRRRRRR", 5)]
)
def test_the_first_graph_of_a_file_runs_and_is_proved(tmp_path, kinds, seed):
    path = chain_file(tmp_path, kinds, seed)
    graph = made(tmp_path, str(path))
    sound(graph)
    assert graph.robot.n == len(kinds.replace("-", ""))


@pytest.mark.parametrize("seed", range(20))
def test_the_first_graph_of_a_random_chain_runs_and_is_proved(tmp_path, seed):
    path = random_chain(tmp_path, seed)
    graph = made(tmp_path, str(path))
    sound(graph)
    assert graph.robot.n == path.read_text().count("<joint")


def test_the_law_of_a_first_graph_halves_the_error_of_the_kinematic_command(tmp_path):
    graph = made(tmp_path, str(chain_file(tmp_path, "RRRRRR", 7)))
    assert error(graph) < 0.5 * error(graph.baseline())


def test_held_joints_leave_an_arm_of_the_others(tmp_path):
    path = chain_file(tmp_path, "PRRRRRRR", 8)
    graph = made(tmp_path, str(path), hold={"j1": 0.1, "j3": -0.2})
    assert graph.robot.joint_names == ("j2", "j4", "j5", "j6", "j7", "j8")
    assert dict(graph.file.robot.hold) == {"j1": 0.1, "j3": -0.2}


def test_limits_that_are_missing_or_zero_are_none(tmp_path):
    """A velocity limit of zero is a placeholder of exporters: with it the robot could not move."""
    path = chain_file(tmp_path, "RRRR", 0)
    text = path.read_text().replace(LIMIT, '<limit effort="0" velocity="0" lower="0" upper="0"/>', 2)
    path.write_text(text.replace(LIMIT, '<limit lower="-1" upper="1"/>', 1))
    first = first_graph(str(path), tmp_path)
    assert [note for note in first.notes if note.startswith("joint")] == [
        "joint j1: no limit of position, velocity and effort in the file; it turns without limits",
        "joint j2: no limit of position, velocity and effort in the file; it turns without limits",
        "joint j3: no limit of velocity and effort in the file",
    ]
    graph = made(tmp_path, str(path))
    assert [joint.upper for joint in graph.robot.joints] == [np.inf, np.inf, 1.0, 2.5]
    assert min(graph.blocks["path"].amplitude) > 0.1


def test_placeholders_are_stated_in_the_graph_and_in_the_file(tmp_path):
    first = first_graph(str(chain_file(tmp_path, "RRRR-", 0)), tmp_path)
    assert list(first.robot) == ["made_arm.urdf"]
    assert first.text.count("# Assumed: link l") == 4
    assert first.robot["made_arm.urdf"].count("placeholder of") == 4
    assert sum("placeholder" in note for note in first.notes) == 4


@pytest.mark.parametrize("changed", [False, True])
@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        (r'(l2"><inertial>.*?value=")', r"\1-", "link l2: expected a mass >= 0, found -"),
        ('link="l1"/><child', 'link="l_1"/><child', "joint j2: its parent l_1 is not a link of the file; did you mean"),
    ],
)
def test_a_fault_has_the_line_of_the_users_file(tmp_path, changed, old, new, fault):
    """Also where the robot file is repaired, here by a limit: the copy has other lines."""
    path = chain_file(tmp_path, "RRRR", 0)
    text = re.sub(old, new, path.read_text().replace("<link", "\n\n<link").replace("<joint", "\n<joint"), count=1)
    path.write_text(text.replace(' velocity="3"', "", int(changed)))
    where, name = "robot made.urdf", fault.partition(":")[0].replace(" ", ' name="')
    line = next(number for number, row in enumerate(text.splitlines(), 1) if name in row)
    with pytest.raises(RobotError, match=re.escape(f"{where}:{line}: {fault}")):
        first_graph(str(path), tmp_path)


def test_moments_of_inertia_that_no_body_has_are_noticed_with_the_link(tmp_path):
    path = chain_file(tmp_path, "RRRR", 0)
    assert not any("no body" in note for note in first_graph(str(path), tmp_path).notes)
    moments = 'ixx="0.0001" iyy="0.0528" izz="0.1528"'
    path.write_text(re.sub('(l3">.*?)ixx="[^"]*" iyy="[^"]*" izz="[^"]*"', rf"\1{moments}", path.read_text()))
    (note,) = (note for note in first_graph(str(path), tmp_path).notes if "no body" in note)
    assert note.startswith("link l3: no body has its moments of inertia, 0.0001, 0.0528 and 0.153 kg m^2")


def test_limits_in_degrees_and_masses_in_grams_are_noticed_with_the_element(tmp_path):
    path = chain_file(tmp_path, "RRRR", 0)
    text = path.read_text()
    path.write_text(re.sub('(l3">.*?<mass value=")[^"]*', r"\g<1>8400", text).replace("2.5", "360", 2))
    limits, mass = (note for note in first_graph(str(path), tmp_path).notes if "j1" in note or "l3" in note)
    assert limits.startswith("joint j1: limits of -360 and 360 rad, 115 turns; a URDF has radians")
    assert mass.startswith("link l3: no body of 8400 kg has moments of inertia as small")


def test_a_joint_at_which_the_arm_ends_is_noticed(tmp_path):
    path = chain_file(tmp_path, "RRRRR", 0)
    path.write_text(re.sub('(name="j5" type=")revolute', r"\1planar", path.read_text()))
    (note,) = (note for note in first_graph(str(path), tmp_path).notes if "planar" in note)
    assert note == "joint j5 of type planar is not part of the arm: expected revolute, continuous or prismatic"


def test_a_joint_is_held_inside_its_limits(tmp_path):
    path = chain_file(tmp_path, "RRRRR", 0)
    says = (
        "hold: joint j2: expected a position from -2.5 to 2.5 rad, its limits, found 90 rad; for degrees write 90 deg"
    )
    with pytest.raises(DmframeError, match=says):
        first_graph(str(path), tmp_path, hold={"j2": 90.0})
    assert first_graph(str(path), tmp_path, hold={"j2": 2.5}).text


def test_a_joint_that_floats_is_named_as_in_the_file(tmp_path):
    path = chain_file(tmp_path, "RRRRR", 0)
    path.write_text(path.read_text().replace('type="revolute"', 'type="floating"', 1))
    with pytest.raises(RobotError, match=r"joint j1 is of type floating; .*; if it does not move in use"):
        first_graph(str(path), tmp_path)


def test_the_armature_of_an_mjcf_file_becomes_the_rotor_of_the_arm(tmp_path):
    bodies = "".join(
        f'<body name="b{k}" pos="0.2 0 0.1"><inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>'
        f'<joint name="j{k}" axis="{axis}" range="-2 2" armature="0.1"/>'
        for k, axis in enumerate(("0 0 1", "0 1 0", "0 1 0", "1 0 0"))
    )
    path = tmp_path / "arm.xml"
    path.write_text(f'<mujoco><compiler angle="radian"/><worldbody>{bodies}{"</body>" * 4}</worldbody></mujoco>')
    graph = made(tmp_path, str(path))
    np.testing.assert_allclose(graph.blocks["arm"].rotor, [0.1] * 4)
    sound(graph)


@pytest.mark.parametrize(
    ("kinds", "tool", "reason"),
    [
        ("RRR", None, "3 joints move on the way to l3 (j1, j2, j3); expected an arm with 4 to 7: name another frame"),
        ("RRRRRRRR", None, "expected an arm with 4 to 7: hold some with --hold JOINT=POSITION, or name another frame"),
        ("RRRRR", "l2", "2 joints move on the way to l2 (j1, j2); expected an arm with 4 to 7: name another frame"),
    ],
)
def test_a_robot_that_is_not_an_arm_is_refused_in_one_sentence(tmp_path, kinds, tool, reason):
    with pytest.raises(RobotError, match=re.escape(reason)):
        first_graph(str(chain_file(tmp_path, kinds, 0)), tmp_path, tool)


def test_an_unknown_tool_names_the_frames(tmp_path):
    with pytest.raises(UnknownNameError, match="tool: hand: unknown frame; choose from"):
        first_graph(str(chain_file(tmp_path, "RRRR", 0)), tmp_path, "hand")


def test_a_robot_is_a_name_or_a_file():
    assert is_robot("ur10e")
    assert is_robot("my.urdf.xacro")
    assert not is_robot("ur30")


def test_an_arm_of_one_joint_has_a_first_graph() -> None:
    found = first_graph("pendulum", Path())
    assert "type: pid_servo" in found.text


def test_joints_of_a_gripper_are_named_as_held(tmp_path):
    path = chain_file(tmp_path, "RRRRR", 5)
    assert not [note for note in first_graph(str(path), tmp_path).notes if note.startswith("held")]
    note = next(note for note in first_graph(str(path), tmp_path, "l4").notes if note.startswith("held"))
    assert note == "held at 0, since they are not between base and tool: j5"


def test_the_command_takes_an_arm_with_few_axes(tmp_path):
    path = chain_file(tmp_path, "RR", 0)
    target = tmp_path / "two.yaml"
    new(str(path), target, out=None, tool=None, hold=[], force=False)
    graph = dm.load(target)
    assert graph.verify().proved
    assert graph.run(until=5.0, judge=False).error.rms_by_eighth[-1] < 0.02
