"""Robot files of other formats as URDF, the choice of the tool, and repairs, with a seeded fault for each refusal."""

from __future__ import annotations

import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from dmframe.common.errors import DmframeError, MissingError, RobotError
from dmframe.graph.first import first_graph
from dmframe.robot.chain import SerialChain, pin_configuration
from dmframe.robot.convert import read_any, written
from dmframe.robot.flange import flange_of
from dmframe.robot.repairs import repaired

MOMENTS = '<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/>'
INERTIAL = f'<inertial><origin xyz="0.1 0 0"/><mass value="2"/>{MOMENTS}</inertial>'
BAD = INERTIAL.replace('ixx=".1"', 'ixx="-.1"')
LIMIT = '<limit lower="-2" upper="2" velocity="3" effort="50"/>'
MJCF = """<mujoco model="arm"><compiler angle="radian"/><worldbody>
<body name="one" pos="0 0 0.3" euler="0.1 0.2 0.3"><inertial pos="0.02 0 0.1" mass="3"
fullinertia="0.03 0.04 0.02 0.001 0.002 0"/>
<joint name="j1" axis="0 0 1" range="-2 2" {armature}/>
<body name="two" pos="0.1 0 0.4"><inertial pos="0 0.1 0.1" mass="2" diaginertia="0.02 0.03 0.01"/>
<joint name="j2" axis="0 1 0" range="-1 2"/>
<body name="three" pos="0.3 0 0" quat="0.9 0.1 0.3 0.2"><inertial pos="0 0 0.05" mass="1" diaginertia="0.01 0.01 0.01"/>
<joint name="j3" type="slide" axis="0 0 1" range="0 0.3"/>
<body name="four" pos="0 0 0.2"><geom type="capsule" size="0.04 0.1" mass="0.7" pos="0.01 0 0.05"/>
<joint name="j4" axis="1 0 0" range="-3 3"/><site name="tcp" pos="0 0.05 0.1"/>
</body></body></body></body></worldbody></mujoco>"""


def joint(name: str, parent: str, child: str, kind: str = "revolute", extra: str = "") -> str:
    limit = "" if kind == "fixed" else f'<axis xyz="0 1 0"/>{LIMIT}'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 0.3"/>{limit}{extra}</joint>'
    )


def arm(n: int = 4, end: str = "", without: tuple[int, ...] = ()) -> str:
    """An arm of n joints, with further elements at its end."""
    links = "".join(f'<link name="l{k}">{"" if k in without else INERTIAL}</link>' for k in range(n + 1))
    joints = "".join(joint(f"j{k}", f"l{k - 1}", f"l{k}") for k in range(1, n + 1))
    return f'<robot name="arm">{links}{joints}{end}</robot>'


FINGERS = (
    f'<link name="f1">{INERTIAL}</link><link name="f2">{INERTIAL}</link>'
    + joint("g1", "l4", "f1", "prismatic")
    + joint("g2", "l4", "f2", "prismatic")
)
FLANGE = '<link name="tool0"/>' + joint("fixed", "l4", "tool0", "fixed")
CAMERA = '<link name="camera"/>' + joint("to_camera", "l4", "camera", "fixed")


@pytest.mark.parametrize(
    ("end", "tool"),
    [
        ("", "l4"),
        (FLANGE, "tool0"),
        (FINGERS, "l4"),
        (CAMERA + FLANGE + FINGERS, "tool0"),
        (CAMERA, "camera"),
        (FLANGE + f'<link name="jaw">{INERTIAL}</link>' + joint("g", "l4", "jaw"), "tool0"),
    ],
)
def test_the_flange_is_before_the_fingers(end, tool):
    assert flange_of(ElementTree.fromstring(arm(end=end)), "robot a") == tool


def test_of_two_arms_none_is_chosen():
    second = "".join(f'<link name="r{k}">{INERTIAL}</link>' for k in range(1, 5))
    second += "".join(joint(f"k{k}", "l0" if k == 1 else f"r{k - 1}", f"r{k}") for k in range(1, 5))
    with pytest.raises(RobotError, match=r"name the tool with --tool, one of l4 \(4 joints\), r4 \(4 joints\)"):
        flange_of(ElementTree.fromstring(arm(end=second)), "robot a")


def branch(name: str, n: int, start: str) -> str:
    """A chain of n joints with its links, starting from a link of the arm."""
    links = "".join(f'<link name="{name}{k}">{INERTIAL}</link>' for k in range(1, n + 1))
    return links + "".join(
        joint(f"to_{name}{k}", start if k == 1 else f"{name}{k - 1}", f"{name}{k}") for k in range(1, n + 1)
    )


MIMIC = '<mimic joint="g1"/>'


@pytest.mark.parametrize(
    ("n", "end", "tool"),
    [
        (4, branch("left", 3, "l0") + branch("right", 3, "l0"), "l4"),  # legs
        (4, branch("head", 2, "l1"), "l4"),
        (7, branch("thumb", 4, "l7") + branch("index", 4, "l7"), "l7"),  # a hand
        (4, branch("head", 2, "l4") + branch("arm", 6, "l4"), "arm6"),  # no hand: six joints are not a finger
        (5, f'<link name="moving_jaw">{INERTIAL}</link>' + joint("gripper", "l5", "moving_jaw"), "l5"),
        (5, f'<link name="l6">{INERTIAL}</link>' + joint("roll", "l5", "l6"), "l6"),
        (
            5,
            "".join(f'<link name="k{k}">{INERTIAL}</link>' for k in (1, 2))
            + joint("g1", "l5", "k1")
            + joint("g2", "l5", "k2", extra=MIMIC),
            "l5",
        ),
    ],
)
def test_legs_heads_hands_and_grippers_are_no_part_of_the_arm(n, end, tool):
    assert flange_of(ElementTree.fromstring(arm(n, end)), "robot a") == tool


def test_a_robot_without_an_arm_is_refused_with_the_ends_of_its_chains():
    text = f'<robot name="a"><link name="l0"/>{branch("left", 3, "l0")}{branch("right", 3, "l0")}</robot>'
    with pytest.raises(
        RobotError, match=r"4 to 7 moving joints, found chains to left3 \(3 joints\), right3 \(3 joints\)"
    ):
        flange_of(ElementTree.fromstring(text), "robot a")


def test_a_prefix_without_a_namespace_is_part_of_a_name(tmp_path):
    """Exports for Gazebo have elements such as <controller:gazebo_ros/>, which a parser of namespaces refuses."""
    path = tmp_path / "a.urdf"
    path.write_text(arm(end='<controller:gazebo_ros name="c"><topic>/c</topic></controller:gazebo_ros>'))
    root = read_any(path).root
    assert repaired(root, "l4", "robot a") == []
    path.write_text(written(root, []))
    assert SerialChain.from_urdf(path).n == 4


def test_joints_off_the_way_are_fixed_where_their_numbers_are_invalid(tmp_path):
    path = tmp_path / "a.urdf"
    path.write_text(arm(end=branch("head", 2, "l1").replace('upper="2"', 'upper="-3"', 1)))
    with pytest.raises(DmframeError, match="expected lower <= upper"):
        SerialChain.from_urdf(path, tool="l4")
    root = read_any(path).root
    (note,) = repaired(root, "l4", "robot a")
    assert note == "joint to_head1: invalid, made fixed; the joint is not between the base and l4"
    path.write_text(written(root, []))
    chain = SerialChain.from_urdf(path, tool="l4")
    assert [float(body[0]) for body in chain.inertia] == [6, 2, 2, 2]  # the head counts


def test_a_mass_without_moments_gets_those_of_a_sphere(tmp_path):
    path = tmp_path / "a.urdf"
    path.write_text(arm().replace('ixx=".1" iyy=".1" izz=".1"', 'ixx="0" iyy="0" izz="0"'))
    root = read_any(path).root
    notes = repaired(root, "l4", "robot a")
    assert notes[0] == "link l1: no moments of inertia in the file; placeholder of 0.005 kg m^2"
    path.write_text(written(root, notes))
    assert float(SerialChain.from_urdf(path).inertia[0][4]) == pytest.approx(0.005)


def test_only_the_way_to_the_tool_must_be_valid(tmp_path):
    head = f'<link name="head">{BAD}</link>' + joint("neck", "l1", "head", "fixed")
    root = ElementTree.fromstring(arm(end=head))
    assert repaired(root, "l4", "robot a") == [
        "link head: invalid inertia removed; the link is not between the base and l4"
    ]
    path = tmp_path / "a.urdf"
    path.write_text(written(root, []))
    assert SerialChain.from_urdf(path, tool="l4").n == 4
    root = ElementTree.fromstring(arm().replace(INERTIAL, BAD, 3))
    assert repaired(root, "l4", "robot a") == []
    path.write_text(written(root, []))
    with pytest.raises(DmframeError, match="expected ixx >= 0"):
        SerialChain.from_urdf(path, tool="l4")


def test_a_link_without_inertia_gets_a_placeholder_that_is_stated(tmp_path):
    path = tmp_path / "a.urdf"
    path.write_text(arm(without=(2, 4)))
    with pytest.raises(RobotError, match="the mass matrix is not positive definite"):
        SerialChain.from_urdf(path)
    root = read_any(path).root
    notes = repaired(root, "l4", "robot a")
    assert [note.partition(":")[0] for note in notes] == ["link l2", "link l4"]
    assert "no inertia in the file; placeholder of 1.5 kg and 0.0121 kg m^2" in notes[0]
    path.write_text(text := written(root, notes))
    assert all(note in text for note in notes)
    assert [float(body[0]) for body in SerialChain.from_urdf(path).inertia] == [2, 1.5, 2, 0.5]


@pytest.fixture
def mjcf(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(MJCF.format(armature='armature="0.5"'))
    return path


def test_an_mjcf_file_has_the_mass_matrix_and_the_bias_of_mujoco(mjcf, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    file = read_any(mjcf)
    assert file.armature == {"j1": 0.5}
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(written(file.root, []))
    chain = SerialChain.from_urdf(urdf, tool="tcp")
    assert [joint.kind for joint in chain.joints] == ["revolute", "revolute", "prismatic", "revolute"]
    assert [(joint.lower, joint.upper) for joint in chain.joints] == [(-2, 2), (-1, 2), (0, 0.3), (-3, 3)]
    import pinocchio as pin

    model = mujoco.MjModel.from_xml_path(str(mjcf))
    data, ours = mujoco.MjData(model), chain.model.createData()
    random = np.random.default_rng(0)
    for _ in range(20):
        data.qpos[:], data.qvel[:] = random.uniform(-1, 1, (2, 4))
        mujoco.mj_forward(model, data)
        M = np.zeros((4, 4))
        mujoco.mj_fullM(model, data, M)
        q = pin_configuration(chain, data.qpos)
        pin.crba(chain.model, ours, q)
        found = np.triu(ours.M) + np.triu(ours.M, 1).T
        np.testing.assert_allclose(found + np.diag([0.5, 0, 0, 0]), M, atol=1e-9)
        bias = pin.nonLinearEffects(chain.model, ours, q, np.array(data.qvel))
        np.testing.assert_allclose(bias, data.qfrc_bias, atol=1e-8)
        pin.framesForwardKinematics(chain.model, ours, q)
        np.testing.assert_allclose(ours.oMf[chain.model_tool].translation, data.site("tcp").xpos, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("<robot", "robot a.xml: expected a URDF, xacro or MJCF file, found broken XML"),
        ("<html/>", "robot a.xml: expected <robot> of a URDF or <mujoco> of an MJCF file, found <html>"),
        (
            '<mujoco><worldbody><body name="b"><freejoint name="f"/><geom size="1" mass="1"/></body></worldbody>'
            "</mujoco>",
            "robot a.xml: joint f is of type FreeFlyer; expected joints with one axis each",
        ),
        (
            "<mujoco><worldbody><body><joint/></body>",
            "robot a.xml: expected a URDF, xacro or MJCF file, found broken XML",
        ),
    ],
)
def test_what_is_not_a_robot_is_refused(tmp_path, text, reason):
    path = tmp_path / "a.xml"
    path.write_text(text)
    with pytest.raises(RobotError) as caught:
        read_any(path)
    assert str(caught.value).startswith(reason)


def test_a_file_that_is_not_there_is_reported(tmp_path):
    with pytest.raises(MissingError, match=r"robot a\.xacro: expected a robot file, found none at"):
        read_any(tmp_path / "a.xacro")


XACRO = '<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="m" value="3"/>{}</robot>'


def test_a_xacro_file_is_expanded(tmp_path):
    pytest.importorskip("xacrodoc")
    (tmp_path / "inner.xacro").write_text(XACRO.format('<link name="b"/>'))
    path = tmp_path / "a.urdf.xacro"
    path.write_text(XACRO.format('<xacro:include filename="inner.xacro"/><link name="l${m + 1}"/>'))
    file = read_any(path)
    assert file.converted
    assert [link.get("name") for link in file.root.findall("link")] == ["b", "l4"]


def test_a_xacro_file_that_cannot_be_expanded_is_reported_with_its_reason(tmp_path):
    pytest.importorskip("xacrodoc")
    path = tmp_path / "a.xacro"
    path.write_text(XACRO.format('<link name="$(arg which)"/>'))
    with pytest.raises(
        RobotError, match=r"robot a\.xacro: xacro cannot expand it: Undefined substitution argument which"
    ):
        read_any(path)
    path.write_text(XACRO.format('<xacro:include filename="$(find nowhere)/x.xacro"/>'))
    with pytest.raises(RobotError, match=r"Package not found: nowhere; expand it where ROS has this package: xacro a"):
        read_any(path)
    path.write_text(XACRO.format('<xacro:include filename="missing.xacro"/>'))
    with pytest.raises(
        RobotError, match=r"No such file or directory: \S*missing\.xacro; it includes this file; put it"
    ):
        read_any(path)


def test_without_xacrodoc_a_xacro_file_names_the_package(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "xacrodoc", None)
    path = tmp_path / "a.xacro"
    path.write_text(XACRO.format('<link name="l"/>'))
    with pytest.raises(
        MissingError, match=r'need the package xacrodoc, which is not installed; pip install .*\[xacro\]"'
    ):
        read_any(path)


def test_an_invalid_inertia_that_no_free_joint_moves_is_ignored(tmp_path):
    path = tmp_path / "a.urdf"
    path.write_text(arm(end=f'<link name="shelf">{BAD}</link>' + joint("to_shelf", "l0", "shelf")))
    with pytest.raises(DmframeError, match="link shelf: expected ixx >= 0"):
        SerialChain.from_urdf(path)
    assert SerialChain.from_urdf(path, tool="l4").n == 4
    assert SerialChain.from_urdf(path, free=["j1", "j2", "j3", "j4"]).n == 4
    path.write_text(arm(end=f'<link name="head">{BAD}</link>' + joint("neck", "l2", "head")))
    with pytest.raises(DmframeError, match="link head: expected ixx >= 0"):
        SerialChain.from_urdf(path, tool="l4")


def test_a_fragment_of_an_mjcf_file_is_refused_without_lines_of_the_parser(tmp_path):
    path = tmp_path / "part.xml"
    path.write_text("<mujoco><asset/></mujoco>")
    with pytest.raises(RobotError, match=r"cannot read this MJCF file: MJCF [\w :]+$"):
        read_any(path)


def test_a_file_without_a_base_and_an_mjcf_file_with_a_missing_class_are_refused(tmp_path: Path) -> None:
    macros = tmp_path / "macros.urdf"
    for links, found in (
        ("", "there is none"),
        (
            '<link name="a"/><link name="b"/><joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint>'
            '<joint name="k" type="fixed"><parent link="b"/><child link="a"/></joint>',
            "a",
        ),
    ):
        macros.write_text(f'<robot name="r">{links}</robot>')
        with pytest.raises(RobotError, match=found):
            first_graph(str(macros), tmp_path)
    mjcf = tmp_path / "arm.xml"
    mjcf.write_text('<mujoco><worldbody><body childclass="none"><geom size="1"/></body></worldbody></mujoco>')
    with pytest.raises(RobotError, match="refers to nothing"):
        first_graph(str(mjcf), tmp_path)
