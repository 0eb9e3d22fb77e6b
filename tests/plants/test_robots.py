"""A sweep over the packaged robots: each loads, is physically consistent, and names its origin."""

from __future__ import annotations

import hashlib
from xml.etree import ElementTree

import numpy as np
import pytest

from dmframe.robot.library import find_robot, load, robots

EXPECTED = {"arm2": 2, "arm3": 3, "panda": 7, "pendulum": 1, "ur10": 6, "ur3": 6, "ur5": 6, "xarm7": 7, "z1": 6}
EXPECTED |= {"fr3": 7, "gen3": 7, "iiwa14": 7, "so101": 5, "ur10e": 6, "ur16e": 6, "ur3e": 6, "ur5e": 6}
OF_THE_COLLECTION = {
    "panda": "84cd234c9becb62dccb28737bd23b5fcc3e3fbf67821965fa6f1d93c27fb4ff3",
    "ur10": "05326a03240df1f594b9ba7e80b75ca2d22c7466785d576de47fb0d0b31ed2f8",
    "ur3": "c84d0fcfe051274dc8ef19dc76b227af6a119071851943d20247598206ad34c9",
    "ur5": "2e7448be5be80cf6c01f7e2706abd6e3e9030a8b9ec712a4afa30feb946fa1ad",
    "xarm7": "1aaf129ce884286745ddefb61cced020477e4f33059061237b9f40c5477d616b",
    "z1": "cc3b98ea58234a0475904bb82f62afe280af8fc58edb095a545cc5cd360a69c8",
}
"""SHA-256 of joints and inertias as read from the files of example-robot-data 6.0.0."""
OF_THE_MAKER = {
    "fr3": [0.333, 0.0, 0.316, 0.0825, 0.0825, 0.384, 0.088, 0.107],
    "gen3": [0.15643, 0.12838, 0.21038, 0.21038, 0.20843, 0.10593, 0.10593, 0.061525],
    "iiwa14": [0.1475, 0.2125, 0.228, 0.192, 0.2075, 0.1925, 0.091, 0.035],
    "ur3e": [0.15185, 0.24355, 0.2132, 0.13105, 0.08535, 0.0921],
    "ur5e": [0.1625, 0.425, 0.3922, 0.1333, 0.0997, 0.0996],
    "ur10e": [0.1807, 0.6127, 0.57155, 0.17415, 0.11985, 0.11655],
    "ur16e": [0.1807, 0.4784, 0.36, 0.17415, 0.11985, 0.11655],
}
"""Link lengths of the data sheets [m]: each is a coordinate of some joint's placement, or of the tool."""
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
def test_a_robot_states_where_it_comes_from(name):
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


def numbers_of(name):
    chain = load(name)
    text = repr((chain.joints, chain.tool, chain.tool_rotation, chain.inertia, chain.gravity))
    return hashlib.sha256(text.encode()).hexdigest()


@pytest.mark.parametrize("name", OF_THE_COLLECTION)
def test_the_numbers_of_a_robot_are_those_of_the_collection_that_it_was_copied_from(name):
    assert numbers_of(name) == OF_THE_COLLECTION[name]


@pytest.mark.parametrize("name", OF_THE_MAKER)
def test_the_lengths_of_a_robot_are_those_of_its_data_sheet(name):
    chain = load(name)
    found = [abs(float(x)) for joint in chain.joints for x in joint.translation] + [abs(float(x)) for x in chain.tool]
    for length in OF_THE_MAKER[name]:
        assert min(abs(length - other) for other in found) < 2e-6, length


@pytest.mark.parametrize("name", sorted(set(EXPECTED) - {"arm2", "arm3", "pendulum"}))
def test_a_copied_robot_has_its_licence_and_its_few_meshes_with_it(name):
    folder = find_robot(name).folder
    assert "Redistribution and use" in (text := (folder / "LICENSE").read_text()) or "Apache License" in text
    named = {mesh.get("filename") for mesh in ElementTree.parse(find_robot(name).urdf).getroot().iter("mesh")}
    kept = {f"meshes/{file.name}" for file in folder.glob("meshes/*")}
    assert named == kept
    assert sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) < 130_000
