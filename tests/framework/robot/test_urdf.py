"""Numbers of a URDF: malformed text is a fault with its line, and is never read as another robot."""

from __future__ import annotations

import math
import random
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from dmframe.common.errors import DmframeError, Faults, RobotError
from dmframe.robot import urdf
from dmframe.robot.library import find_robot, robots
from dmframe.robot.urdf import read_urdf

ARM = """<robot name="arm">
  <link name="base"/>
  <link name="a">
    <inertial>
      <origin xyz="0.1 0.02 -0.03" rpy="0.3 -0.2 0.7"/>
      <mass value="2.5"/>
      <inertia ixx="0.02" iyy="0.03" izz="0.025" ixy="0.001" ixz="-0.002" iyz="0.0015"/>
    </inertial>
    <visual><geometry><mesh filename="a.stl" scale="1 1 1"/></geometry></visual>
  </link>
  <joint name="j" type="revolute">
    <parent link="base"/><child link="a"/>
    <origin xyz="0.1 0 0.2" rpy="0 0.5 0"/>
    <axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="100" velocity="3"/>
    <dynamics damping="0.1" friction="0.2"/>
  </joint>
</robot>
"""


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], Path]:
    def write(text: str) -> Path:
        file = tmp_path / "arm.urdf"
        file.write_text(text, encoding="utf-8")
        return file

    return write


def fault_of_file(file: Path) -> str:
    with pytest.raises(DmframeError) as caught:
        read_urdf(file)
    faults = caught.value.faults if isinstance(caught.value, Faults) else (caught.value,)
    assert all(isinstance(fault, RobotError) and fault.path == ("robot", "model") for fault in faults)
    return str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (
            "0.1 0.02 -0.03",
            "0.1 O.02 -0.03",
            "5: link a: expected 3 finite numbers as xyz of <origin>, found '0.1 O.02",
        ),
        ("0.1 0.02 -0.03", "0.1 0.02", "5: link a: expected 3 finite numbers as xyz of <origin>, found '0.1 0.02'"),
        ("0.3 -0.2 0.7", "0.3 -0.2 0.7 0", "5: link a: expected 3 finite numbers as rpy of <origin>, found"),
        ('"2.5"', '"2,5"', "6: link a: expected a finite mass, found '2,5'"),
        ('"2.5"', '"1_0"', "6: link a: expected a finite mass, found '1_0'"),
        ('"2.5"', '"0x10"', "6: link a: expected a finite mass, found '0x10'"),
        ('"2.5"', '"1e400"', "6: link a: expected a finite mass, found '1e400'"),
        ('"2.5"', '"-1"', "6: link a: expected a mass >= 0, found -1"),
        (' value="2.5"', "", "6: link a: expected value in <mass>, found none"),
        ('<mass value="2.5"/>', "", "4: link a: expected <mass> in <inertial>, found none"),
        (' ixy="0.001"', "", "7: link a: expected ixy in <inertia>, found none"),
        ('ixz="-0.002"', 'ixz="-0.002l"', "7: link a: expected a finite ixz, found '-0.002l'"),
        ('<mass value="2.5"/>', '<mass value="2.5"/><mass value="3"/>', "6: link a: expected one <mass>, found 2"),
        ("1 1 1", "1 1 i", "9: link a: expected 3 finite numbers as scale of <mesh>, found '1 1 i'"),
        ("0.1 0 0.2", "0.1 0 0.2.", "13: joint j: expected 3 finite numbers as xyz of <origin>, found '0.1 0 0.2.'"),
        ("0 0.5 0", "0 nan 0", "13: joint j: expected 3 finite numbers as rpy of <origin>, found '0 nan 0'"),
        ("0 0 1", "0 0", "14: joint j: expected 3 finite numbers as xyz of <axis>, found '0 0'"),
        ("0 0 1", "0 0.0 0", "14: joint j: expected a nonzero axis, found 0 0.0 0"),
        ('lower="-3"', 'lower="-3 rad"', "15: joint j: expected a finite lower, found '-3 rad'"),
        ('lower="-3"', 'lower="4"', "15: joint j: expected lower <= upper, found 4 and 3"),
        (' effort="100"', "", "15: joint j: expected effort in <limit>, found none"),
        ('velocity="3"', 'velocity="inf"', "15: joint j: expected a finite velocity, found 'inf'"),
        ('damping="0.1"', 'damping="low"', "16: joint j: expected a finite damping, found 'low'"),
    ],
)
def test_a_malformed_number_has_its_line(write: Callable[[str], Path], old: str, new: str, text: str) -> None:
    assert ARM.count(old) >= 1
    assert f"robot arm.urdf:{text}" in fault_of_file(write(ARM.replace(old, new, 1)))


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('iyy="0.03"', 'iyy="-5"', "7: link a: expected iyy >= 0, found -5"),
        (
            'ixy="0.001"',
            'ixy="1"',
            "7: link a: expected an inertia whose principal moments are >= 0, found -0.975 among",
        ),
        ('"2.5"', '"1e308"', "6: link a: expected a number below 1e+100, found '1e308'"),
        ("0.1 0 0.2", "1e100 0 0", "13: joint j: expected numbers below 1e+100, found '1e100 0 0'"),
        ("0 0 1", "1e-200 0 0", "14: joint j: expected an axis of length near 1, found 1e-200 0 0"),
        ("0 0 1", "1e308 1e308 0", "14: joint j: expected an axis of length near 1, found 1e308 1e308 0"),
    ],
)
def test_a_number_that_no_body_has_is_reported_with_its_line(
    write: Callable[[str], Path], old: str, new: str, text: str
) -> None:
    assert f"robot arm.urdf:{text}" in fault_of_file(write(ARM.replace(old, new, 1)))


TAIL = """  <link name="b"/>
  <joint name="k" type="fixed"><parent link="a"/><child link="b"/></joint>
</robot>
"""


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (
            '<child link="a"/>',
            '<child link="base"/>',
            "11: joint j: expected a tree, found a loop: its parent base moves",
        ),
        (
            '<parent link="base"/>',
            '<parent link="b"/>',
            "11: joint j: expected a tree, found a loop: its parent b moves",
        ),
        (
            '<child link="b"/>',
            '<child link="a"/>',
            "19: joint k: expected each link to be the child of one joint, found a",
        ),
        ('<link name="b"/>', '<link name="b"/><link name="c"/>', "18: link c: expected one base, found base and c"),
        ('<joint name="j"', '<joint name=""', "11: joint without a name: expected a name of this joint, found none"),
        ('<joint name="j"', "<joint", "11: joint without a name: expected a name of this joint, found none"),
        ('<link name="b"', '<link name=" "', "18: link  : expected a name of this link, found none"),
        ('<joint name="k"', '<joint name="j"', "19: joint j: expected one joint of that name, found two"),
        ('<link name="b"', '<link name="a"', "18: link a: expected one link of that name, found two"),
        ('<child link="b"/>', '<child link="bb"/>', "19: joint k: its child bb is not a link of the file; "),
        ('<parent link="a"/>', "<parent/>", "19: joint k: its parent without a name is not a link of the file; "),
        ('<parent link="a"/>', "", "19: joint k: expected one <parent>, found none"),
        ('<child link="b"/>', '<child link="b"/><child link="a"/>', "19: joint k: expected one <child>, found 2"),
        (
            'type="fixed"',
            'type="stiff"',
            "19: joint k: expected a joint type, revolute, continuous, prismatic, fixed",
        ),
    ],
)
def test_joints_that_make_no_tree_are_reported_with_their_line(
    write: Callable[[str], Path], capfd: pytest.CaptureFixture[str], old: str, new: str, text: str
) -> None:
    two = ARM.replace("</robot>\n", TAIL)
    read_urdf(write(two))
    assert two.count(old) == 1
    assert f"robot arm.urdf:{text}" in fault_of_file(write(two.replace(old, new)))
    assert capfd.readouterr() == ("", "")


def test_what_pinocchio_refuses_is_reported_as_a_fault_of_the_file(
    write: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any) -> Any:
        raise RuntimeError("The 3d inertia should be positive.")

    monkeypatch.setattr(pin, "Inertia", type("Inertia", (), {"__init__": refuse, "Zero": refuse}))
    assert fault_of_file(write(ARM)) == (
        "robot arm.urdf: expected a valid URDF; the parser reports: The 3d inertia should be positive"
    )


def test_a_joint_without_limits_is_reported(write: Callable[[str], Path]) -> None:
    text = re.sub("<limit.*/>", "", ARM)
    assert "robot arm.urdf:11: joint j: expected <limit> of a revolute joint, found none" in fault_of_file(write(text))


def test_all_malformed_numbers_are_reported_at_once(write: Callable[[str], Path]) -> None:
    text = fault_of_file(write(ARM.replace("0.02 -0.03", "o").replace("0 0 1", "0 0 l")))
    assert "arm.urdf:5" in text
    assert "arm.urdf:14" in text


@pytest.mark.parametrize("blank", ["\n", "\t", "  ", "&#10;", "&#9;", " "])
def test_white_space_that_pinocchio_would_not_take_is_written_as_a_blank(
    write: Callable[[str], Path], blank: str
) -> None:
    plain, _ = read_urdf(write(ARM))
    odd = ARM.replace("0.1 0.02 -0.03", f"0.1{blank}0.02{blank}-0.03").replace('"2.5"', f'"{blank}2.5{blank}"')
    model, _ = read_urdf(write(odd))
    assert model == plain
    np.testing.assert_allclose(model.inertias[1].mass, 2.5)


def attributes(root: ElementTree.Element) -> list[tuple[ElementTree.Element, str]]:
    """Attributes that contain numbers, found by their text and not by their names."""
    number = re.compile(r"\s*[-+0-9.eE]+(\s+[-+0-9.eE]+)*\s*")
    return [
        (element, key) for element in root.iter() for key, value in element.attrib.items() if number.fullmatch(value)
    ]


def is_numbers(text: str) -> bool:
    try:
        return all(math.isfinite(float(word)) for word in text.split())
    except ValueError:
        return False


MISTYPED = {
    "0": "O",
    "1": "l",
    ".": ",",
    "-": "--",
    "2": "2x",
    "3": "",
    "5": "\uff15",
    "7": "7 7",
    "8": "8e",
    "9": "_9",
}


@pytest.mark.parametrize("robot", ["arm2", "ur10", "panda"])
@pytest.mark.parametrize("seed", range(3))
def test_a_mistyped_number_is_an_error_or_the_same_number(tmp_path: Path, robot: str, seed: int) -> None:
    rng = random.Random(seed)
    text = Path(robots()[robot].urdf).read_text(encoding="utf-8")
    original, _ = read_urdf(Path(robots()[robot].urdf))
    refused = 0
    for _ in range(12):
        root = ElementTree.fromstring(text)
        element, key = rng.choice(attributes(root))
        value = element.attrib[key]
        places = [k for k, letter in enumerate(value) if letter in MISTYPED]
        if not places:
            continue
        k = rng.choice(places)
        element.set(key, value[:k] + MISTYPED[value[k]] + value[k + 1 :])
        file = tmp_path / "mistyped.urdf"
        file.write_text(ElementTree.tostring(root, encoding="unicode"), encoding="utf-8")
        try:
            model, _ = read_urdf(file)
        except RobotError:
            refused += 1
            continue
        # accepted text is a number for an independent reader too, or does not define the robot
        assert is_numbers(element.attrib[key]) or model == original, (element.tag, element.attrib[key])
    assert refused > 3


def test_every_packaged_robot_reads_as_pinocchio_alone_reads_it() -> None:
    for source in robots().values():
        model, _ = read_urdf(source.urdf)
        assert model == pin.buildModelFromXML(source.urdf.read_text(encoding="utf-8")), source.name


def test_a_reader_that_drops_an_inertia_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    read = pin.buildModelFromXML

    def dropping(text: str) -> Any:
        model = read(text)
        model.inertias[2] = pin.Inertia.Zero()
        return model

    monkeypatch.setattr(pin, "buildModelFromXML", dropping)
    assert urdf.read_urdf  # the module imports Pinocchio when it reads, so the seeded fault would be in the way
    assert "fixed to it differs from the file" in fault_of_file(find_robot("arm2").urdf)
