"""A sweep over the packaged robots: each loads, is lawful, and says where it comes from."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from dmframe.robot.library import find_robot, load, robots

EXPECTED = {"arm2": 2, "arm3": 3, "panda": 7, "pendulum": 1, "ur10": 6, "ur3": 6, "ur5": 6, "xarm7": 7, "z1": 6}
NAMES = sorted(EXPECTED)


def test_every_expected_robot_is_packaged():
    assert set(robots()) >= set(EXPECTED)


@pytest.mark.parametrize("name", NAMES)
def test_a_robot_has_its_joints_and_a_task_that_they_can_reach(name):
    chain = load(name)
    assert chain.n == EXPECTED[name]
    assert chain.m <= chain.n
    assert chain.rotation_change < 1e-11


@pytest.mark.parametrize("name", NAMES)
def test_a_robot_says_where_it_comes_from(name):
    source = find_robot(name)
    text = (source.folder / "SOURCE.md").read_text()
    for heading in ("Origin:", "Licence:", "## What the numbers mean", "## Joint limits", "## Known errors"):
        assert heading in text
    assert source.description


@pytest.mark.parametrize("name", NAMES)
def test_the_stated_joint_limits_are_those_of_the_model(name):
    text = (find_robot(name).folder / "SOURCE.md").read_text()
    for joint in load(name).joints:
        numbers = (joint.lower, joint.upper, joint.velocity, joint.effort)
        assert f"| `{joint.name}` | " + " | ".join(f"{x:.4g}" for x in numbers) + " |" in text


@pytest.mark.parametrize("name", NAMES)
def test_every_link_with_a_mass_has_a_lawful_inertia(name):
    for link in ElementTree.parse(find_robot(name).urdf).getroot().iter("link"):
        inertial = link.find("inertial")
        if inertial is None or float(inertial.find("mass").get("value")) == 0:
            continue
        entry = {key: float(value) for key, value in inertial.find("inertia").attrib.items()}
        tensor = [[entry["i" + "".join(sorted(a + b))] for b in "xyz"] for a in "xyz"]
        small, middle, large = np.linalg.eigvalsh(tensor)
        assert small > 0
        assert large <= (small + middle) * (1 + 1e-9)


@pytest.mark.parametrize("name", ["arm2", "arm3", "pendulum"])
def test_a_teaching_robot_can_hold_itself_anywhere(name):
    from importlib import import_module

    form, chain = import_module(f"dmframe_plants.{name}.closed_form"), load(name)
    limits = np.array([joint.effort for joint in chain.joints])
    for q in np.random.default_rng(0).uniform(-3, 3, size=(200, chain.n)):
        assert np.all(np.abs(form.gravity_torque(q)) < 0.8 * limits)
