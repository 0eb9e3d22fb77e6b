from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pinocchio as pin
import pytest

from dmframe.common.errors import DmframeError, MissingError, RobotError, UnknownNameError, ValueFault
from dmframe.robot.chain import SerialChain, pin_configuration
from dmframe.robot.library import find_robot, load

UR10 = find_robot("ur10").urdf
PANDA = find_robot("panda").urdf
FIRST_THREE = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")

INERTIAL = '<inertial><mass value="{mass}"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="{izz}"/></inertial>'
LIMIT = '<limit lower="-1" upper="2" velocity="3" effort="4"/>'


def link(name, mass="1", izz="1", bare=False):
    return f'<link name="{name}">{"" if bare else INERTIAL.format(mass=mass, izz=izz)}</link>'


def joint(name, parent, child, kind="revolute", extra=""):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.1 0 0.2"/><axis xyz="0 0 1"/>{LIMIT}{extra}</joint>'
    )


@pytest.fixture
def urdf(tmp_path):
    """A function that writes a URDF of the given elements."""

    def write(*elements, text=None):
        file = tmp_path / "arm.urdf"
        file.write_text(text if text is not None else f'<robot name="arm">{"".join(elements)}</robot>')
        return file

    return write


@pytest.fixture
def fork(urdf):
    """A robot that branches behind its first joint."""
    links = [link(name) for name in ("base", "a", "b", "c")]
    return urdf(*links, joint("j1", "base", "a"), joint("left", "a", "b"), joint("right", "a", "c"))


def fault(*arguments, **keywords):
    with pytest.raises(DmframeError) as caught:
        SerialChain.from_urdf(*arguments, **keywords)
    return caught.value


FIX = "if it does not move in use, make it fixed in the robot's file"


def check(error, kind, text, key):
    assert type(error) is kind
    assert str(error) == text
    assert error.path == ("robot", key)


# Content of a chain


def test_a_chain_keeps_its_free_joints_in_the_order_of_the_robot():
    chain = SerialChain.from_urdf(UR10, free=FIRST_THREE[::-1], tool="ee_link")
    assert chain.joint_names == FIRST_THREE
    assert (chain.n, chain.m, chain.k) == (3, 3, 12)


def test_numbers_are_those_of_the_file_as_written():
    chain = load("ur10")
    assert chain.joints[2].translation == (0, Fraction("-0.1719"), Fraction("0.612"))
    assert chain.inertia[0][0] == Fraction("7.778")
    assert chain.gravity == (0, 0, Fraction("-9.81"))
    assert [float(x) for x in chain.inertia[3]] == list(chain.model.inertias[4].toDynamicParameters())


def test_a_quarter_turn_of_ten_digits_is_snapped_and_the_change_is_reported():
    chain = load("ur10")
    assert chain.joints[1].rotation == ((0, 0, 1), (0, 1, 0), (-1, 0, 0))
    assert chain.rotation_change == pytest.approx(4.8966e-12, rel=1e-3)
    assert 0 < load("xarm7").rotation_change < 1e-15


def test_limits_are_the_robots_own_and_infinite_where_it_has_none(urdf):
    free_turning = '<joint name="j2" type="continuous"><parent link="a"/><child link="b"/></joint>'
    chain = SerialChain.from_urdf(urdf(link("base"), link("a"), link("b"), joint("j1", "base", "a"), free_turning))
    first, second = chain.joints
    assert (first.lower, first.upper, first.velocity, first.effort) == (-1, 2, 3, 4)
    assert (second.lower, second.upper) == (-math.inf, math.inf)
    assert (second.velocity, second.effort) == (math.inf, math.inf)


def test_an_unbounded_angle_is_a_cosine_and_a_sine_to_pinocchio(urdf):
    file = urdf(link("base"), link("a"), link("b"), joint("j1", "base", "a", "continuous"), joint("j2", "a", "b"))
    chain = SerialChain.from_urdf(file)
    np.testing.assert_allclose(pin_configuration(chain, [0.5, 0.7]), [math.cos(0.5), math.sin(0.5), 0.7])


def test_held_joints_are_merged_at_their_angle():
    chain = load("ur10", free=FIRST_THREE, hold={"wrist_1_joint": 0.4, "wrist_2_joint": -1.2})
    whole = load("ur10")
    data, q = whole.model.createData(), np.array([0.1, -0.9, 1.1, 0.4, -1.2, 0.0])
    pin.framesForwardKinematics(whole.model, data, q)
    reduced = chain.model.createData()
    pin.framesForwardKinematics(chain.model, reduced, q[:3])
    np.testing.assert_allclose(
        reduced.oMf[chain.model_tool].translation, data.oMf[whole.model_tool].translation, rtol=1e-12
    )
    assert float(sum(row[0] for row in chain.inertia)) == pytest.approx(float(sum(row[0] for row in whole.inertia)))


def test_joints_behind_the_tool_and_off_the_way_to_it_are_held():
    assert SerialChain.from_urdf(PANDA, tool="panda_link4").joint_names == tuple(f"panda_joint{i}" for i in range(1, 5))


def test_without_a_tool_the_only_chain_is_taken_to_its_last_frame():
    chain = SerialChain.from_urdf(UR10)
    assert chain.n == 6
    assert chain.model.frames[chain.model_tool].name == "tool0"


def test_a_tool_may_be_a_point_in_the_last_joints_frame():
    chain = SerialChain.from_urdf(UR10, free=FIRST_THREE, tool=(0.1, 0, 0.25), axes="xz")
    assert chain.tool == (Fraction("0.1"), 0, Fraction("0.25"))
    assert chain.m == 2


def test_a_branch_may_be_held(fork):
    assert SerialChain.from_urdf(fork, free=["right", "j1"]).joint_names == ("j1", "right")


def test_a_mimic_joint_may_be_held():
    assert SerialChain.from_urdf(PANDA, tool="panda_hand_tcp").n == 7


def test_equal_robots_are_equal_whatever_their_pinocchio_models():
    assert load("ur3") == load("ur3")
    assert "model=" not in repr(load("ur3"))


# Faults in a file


def test_a_missing_file_is_named(tmp_path):
    file = tmp_path / "nowhere.urdf"
    check(fault(file), MissingError, f"robot nowhere.urdf: expected a URDF file, found none at {file}", "model")


def test_broken_xml_is_reported_with_line_and_column(urdf):
    error = fault(urdf(text='<robot name="arm">\n  <link name="a">\n</robot>'))
    check(error, RobotError, "robot arm.urdf:3:3: expected a valid URDF, found broken XML: mismatched tag", "model")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("<sdf/>", "expected a valid URDF, <robot>; found <sdf>"),
        ('<robot name="arm"/>', "expected a valid URDF, found no link in it"),
        (
            '<robot name="arm" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:arm/></robot>',
            "expected a URDF, found a xacro file; expand it with xacro first",
        ),
    ],
)
def test_a_file_that_is_not_a_urdf_is_reported(urdf, text, reason):
    check(fault(urdf(text=text)), RobotError, f"robot arm.urdf: {reason}", "model")


def test_a_file_that_is_not_text_is_reported(tmp_path):
    file = tmp_path / "arm.urdf"
    file.write_bytes(b"\xff\xfe\x00<robot/>")
    assert str(fault(file)).startswith("robot arm.urdf: expected a readable URDF file in UTF-8: ")


@pytest.mark.parametrize(
    ("keywords", "reason"),
    [
        ({"mass": "-2"}, "expected a mass >= 0, found -2"),
        ({"mass": "nan"}, "expected a finite mass, found 'nan'"),
        ({"izz": "inf"}, "expected a finite izz, found 'inf'"),
        ({"izz": "one"}, "expected a finite izz, found 'one'"),
    ],
)
def test_a_bad_number_in_an_inertia_is_named_with_its_link(urdf, keywords, reason):
    error = fault(urdf(link("base"), link("a", **keywords), joint("j1", "base", "a")))
    check(error, RobotError, f"robot arm.urdf:1: link a: {reason}", "model")


def test_a_free_joint_without_inertia_behind_it_is_named(urdf):
    file = urdf(link("base"), link("a"), link("b", bare=True), joint("j1", "base", "a"), joint("j2", "a", "b"))
    check(
        fault(file),
        RobotError,
        "robot arm: the mass matrix is not positive definite: the links behind joint j2 have too little mass or "
        "inertia; give its link an inertia, or hold it; `dmframe new FILE` writes a copy with placeholders",
        "model",
    )
    assert SerialChain.from_urdf(file, hold={"j2": 0.0}).n == 1


def test_a_massless_link_is_allowed_where_the_next_one_has_mass(urdf):
    lever = "<origin xyz='0.3 0 0'/>"
    heavy = link("b").replace("<mass", f"{lever}<mass")
    across = joint("j2", "a", "b").replace('xyz="0 0 1"', 'xyz="0 1 0"')
    assert (
        SerialChain.from_urdf(urdf(link("base"), link("a", bare=True), heavy, joint("j1", "base", "a"), across)).n == 2
    )


# Faults in arguments


def test_an_unknown_free_joint_gets_the_nearest_name():
    error = fault(UR10, free=["elbow_jont"])
    check(error, UnknownNameError, "robot ur10: free: elbow_jont: unknown joint; did you mean elbow_joint?", "free")


def test_an_unknown_held_joint_gets_the_nearest_name():
    error = fault(UR10, hold={"wrist_2": 0.0})
    check(error, UnknownNameError, "robot ur10: hold: wrist_2: unknown joint; did you mean wrist_2_joint?", "hold")


def test_an_unknown_tool_gets_the_nearest_frame():
    check(
        fault(UR10, tool="ee_lnk"),
        UnknownNameError,
        "robot ur10: tool: ee_lnk: unknown frame; did you mean ee_link?",
        "tool",
    )


def test_a_joint_cannot_be_free_and_held():
    error = fault(UR10, free=FIRST_THREE, hold={"elbow_joint": 0.0})
    check(error, RobotError, "robot ur10: joint elbow_joint is both free and held; choose one", "hold")


def test_a_free_joint_is_named_once():
    error = fault(UR10, free=["elbow_joint", "elbow_joint"])
    check(error, ValueFault, "robot ur10: free names joint elbow_joint twice", "free")


def test_a_held_angle_is_finite():
    error = fault(UR10, hold={"elbow_joint": math.inf})
    check(error, ValueFault, "robot ur10: expected a finite angle to hold elbow_joint at, found inf", "hold")


def test_free_joints_that_branch_name_the_fork(fork):
    error = fault(fork, free=["j1", "left", "right"])
    check(
        error,
        RobotError,
        "robot arm: expected the free joints to form one chain; at joint j1 it branches into left and right: "
        "hold all branches but one",
        "free",
    )


def test_free_joints_that_branch_at_the_base_are_reported(fork):
    error = fault(fork, free=["left", "right"])
    assert "at the base it branches into left and right" in str(error)


def test_several_chains_without_a_tool_ask_for_one(fork):
    error = fault(fork)
    text = (
        "robot arm: has 2 chains, which end in left, right; name a tool or the free joints in a graph, which "
        "`dmframe new` writes"
    )
    check(error, RobotError, text, "tool")


def test_a_chain_needs_a_free_joint():
    text = "robot ur10: no free joint is left; hold fewer joints"
    check(fault(UR10, tool="base_link"), RobotError, text, "free")
    check(fault(UR10, free=[]), RobotError, text, "free")


def test_a_free_mimic_joint_is_refused():
    error = fault(PANDA, free=["panda_joint1", "panda_finger_joint2"])
    text = "robot panda: joint panda_finger_joint2 mimics another joint; it can be held, not free"
    check(error, RobotError, text, "free")


def test_a_tool_that_the_last_free_joint_does_not_move_is_refused():
    error = fault(UR10, free=FIRST_THREE, tool="upper_arm_link")
    check(
        error,
        RobotError,
        "robot ur10: tool upper_arm_link moves with shoulder_lift_joint, not with the last free joint elbow_joint; "
        "hold the joints behind the tool",
        "tool",
    )


@pytest.mark.parametrize("tool", [(1.0, 2.0), (0.0, math.nan, 1.0)])
def test_a_tool_point_is_three_finite_numbers(tool):
    error = fault(UR10, tool=tool)
    text = f"robot ur10: expected the tool as a frame's name or 3 finite numbers in m, found {list(tool)}"
    check(error, ValueFault, text, "tool")


@pytest.mark.parametrize("axes", ["", "zx", "xx", "xyw"])
def test_axes_are_a_subset_of_xyz_in_order(axes):
    error = fault(UR10, axes=axes)
    text = f"robot ur10: expected axes to be one of x, y, z, xy, xz, yz, xyz; found {axes!r}"
    check(error, ValueFault, text, "axes")


@pytest.mark.parametrize("velocity", [0.0, -1.0, math.nan])
def test_the_friction_velocity_is_positive(velocity):
    error = fault(UR10, friction_velocity=velocity)
    text = f"robot ur10: expected a friction velocity > 0 in rad/s, found {velocity}"
    check(error, ValueFault, text, "friction_velocity")


# Models that no URDF can contain


def model_with(joint_model, frame=True, inertia=None):
    model = pin.Model()
    model.name = "built"
    first = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "first")
    second = model.addJoint(first, joint_model, pin.SE3(np.eye(3), np.ones(3)), "second")
    for index in (first, second):
        if frame:
            model.addJointFrame(index)
        model.appendBodyToJoint(index, inertia or pin.Inertia.FromSphere(1.0, 0.2), pin.SE3.Identity())
    return model


@pytest.mark.parametrize(
    ("joint_model", "kind"),
    [
        (pin.JointModelFreeFlyer(), "floating"),
        (pin.JointModelPlanar(), "planar"),
        (pin.JointModelSpherical(), "Spherical"),
        (pin.JointModelHZ(0.1), "HZ"),
    ],
)
def test_a_free_joint_that_is_neither_revolute_nor_prismatic_is_named_with_its_type(joint_model, kind):
    with pytest.raises(RobotError) as caught:
        SerialChain.from_model(model_with(joint_model))
    text = f"robot built: joint second is of type {kind}; expected a free joint to be revolute or prismatic; {FIX}"
    check(caught.value, RobotError, text, "free")


def test_a_joint_of_several_angles_cannot_be_held_at_one():
    with pytest.raises(RobotError) as caught:
        SerialChain.from_model(model_with(pin.JointModelSpherical()), hold={"second": 0.3})
    text = f"robot built: joint second is of type Spherical; expected a held joint to be revolute or prismatic; {FIX}"
    check(caught.value, RobotError, text, "hold")


def test_other_joints_may_stay_at_neutral():
    assert SerialChain.from_model(model_with(pin.JointModelSpherical()), free=["first"]).joint_names == ("first",)


def test_an_armature_is_refused_rather_than_ignored():
    model = model_with(pin.JointModelRX())
    model.armature = np.array([0.0, 0.1])
    with pytest.raises(RobotError) as caught:
        SerialChain.from_model(model)
    text = "robot built: joint second has an armature; expected none: set rotor of the plant, as in `manipulator`"
    check(caught.value, RobotError, text, "model")


def test_a_joint_without_a_frame_is_reported_before_pinocchio_crashes_on_it():
    with pytest.raises(RobotError) as caught:
        SerialChain.from_model(model_with(pin.JointModelRX(), frame=False))
    text = "robot built: joint first has no frame in the model; call model.addJointFrame on it"
    check(caught.value, RobotError, text, "model")


@pytest.mark.parametrize("mass", [-1.0, math.nan])
def test_a_built_model_with_a_bad_mass_names_the_joint(mass):
    inertia = pin.Inertia(mass, np.zeros(3), np.eye(3))
    with pytest.raises(RobotError) as caught:
        SerialChain.from_model(model_with(pin.JointModelRX(), inertia=inertia))
    text = f"robot built: expected a finite mass >= 0 and a finite inertia behind joint first, found mass {mass:g}"
    check(caught.value, RobotError, text, "model")


@pytest.mark.parametrize("name", ["base", "link1", "link2"])
def test_a_joint_may_be_called_like_a_link(tmp_path, name):
    source = find_robot("arm2").urdf.read_text(encoding="utf-8")
    assert source.count('joint name="joint2"') == 1
    file = tmp_path / "same.urdf"
    file.write_text(source.replace('joint name="joint2"', f'joint name="{name}"'), encoding="utf-8")
    one, other = load("arm2"), load(str(file), tool="tool", axes="xy")
    assert other.joint_names == ("joint1", name)
    q = np.array([0.3, -0.7])
    for chain in (one, other):
        pin.crba(chain.model, data := chain.model.createData(), q)
        masses = np.triu(data.M)
        assert masses == pytest.approx(np.triu(pin.crba(one.model, one.model.createData(), q)))
    assert [frame.name for frame in other.model.frames].count("link1") == 1 + (name == "link1")
