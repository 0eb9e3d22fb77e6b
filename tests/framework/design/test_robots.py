"""`dmframe design` of robots' files: those that are blocked, with the remedy, and limits inside those of the robot."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import dmframe as dm
from dmframe.common.errors import UnknownNameError
from dmframe.design import design as module
from dmframe.design.family import makers
from dmframe.design.limits import limits_text
from dmframe.design.motion import first_path, motion_of
from dmframe.design.obstacle import obstacle
from dmframe.design.race_text import FIRST, race_text
from dmframe.design.request import Request
from dmframe.drive.limits import load_limits
from dmframe.graph.first import EFFORT, MOST_COULOMB, MOST_VISCOUS, first_graph
from dmframe.race.plan import Run
from dmframe.race.read import load_race
from dmframe.robot.chain import pin_configuration
from tests.random_chains import random_chain


def test_a_robot_that_is_no_arm_is_blocked_and_an_unknown_one_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError):
        module.design(Request.of("ur55"), tmp_path / "unknown")
    urdf = tmp_path / "one.urdf"
    urdf.write_text(
        '<robot name="one"><link name="base"/><link name="tip"/><joint name="j" type="revolute"><parent link="base"/>'
        '<child link="tip"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>'
    )
    found = module.design(Request.of(str(urdf)), tmp_path / "few")
    assert found.outcome == "blocked"
    assert "expected an arm with 2 to 7" in found.reason
    assert json.loads((tmp_path / "few" / "design.json").read_text())["outcome"] == "blocked"


@pytest.mark.parametrize(
    ("kinds", "text"),
    [
        ("RRPRR", "joint j3 is prismatic, and such a robot cannot be rehearsed; hold it with --hold j3=POSITION"),
        ("RPRPR", "joints j2 and j4 are prismatic, .* hold them with --hold j2=POSITION --hold j4=POSITION"),
        ("PPPR", "joints j1, j2 and j3 are prismatic, .* without them 1 of at least 2 joints would move"),
    ],
)
def test_an_arm_with_a_prismatic_joint_is_blocked_at_once_with_the_remedy(
    kinds: str, text: str, tmp_path: Path
) -> None:
    (tmp_path / "made.urdf").write_text(sliding_robot(kinds))
    found = module.design(Request.of(str(tmp_path / "made.urdf")), tmp_path / "d")
    assert found.outcome == "blocked"
    assert re.fullmatch(text, found.reason)


def test_the_remedy_leads_to_a_robot_with_which_the_design_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A SCARA arm has three joints without its quill."""
    (tmp_path / "scara.urdf").write_text(sliding_robot("RRPR"))
    monkeypatch.setattr(module, "_raced", lambda first, *_: pytest.fail(first.text))
    with pytest.raises(pytest.fail.Exception, match=r"hold: \{j3: 0\.1\}"):
        module.design(Request.of(str(tmp_path / "scara.urdf"), hold=[("j3", 0.1)]), tmp_path / "d")


def sliding_robot(kinds: str) -> str:
    text = '<robot name="made"><link name="l0"/>'
    for k, letter in enumerate(kinds, 1):
        kind = "prismatic" if letter == "P" else "revolute"
        text += (
            f'<link name="l{k}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
            f'</inertial></link><joint name="j{k}" type="{kind}"><parent link="l{k - 1}"/><child link="l{k}"/>'
            f'<origin xyz="0.2 0 0.1"/><axis xyz="{k % 2} 0 {1 - k % 2}"/>'
            '<limit lower="-1" upper="1" velocity="1" effort="100"/></joint>'
        )
    return f"{text}</robot>"


@pytest.mark.parametrize("end", [1.4835298, 2.0943951023931953, 0.6283185307])
def test_the_limits_of_a_design_are_inside_those_of_its_robot(end: float, tmp_path: Path) -> None:
    """An end of a joint's range with more than six digits, as 85 degrees, is not rounded outwards."""
    text = sliding_robot("RRRR").replace(
        'lower="-1" upper="1" velocity="1"', f'lower="-{end}" upper="{end}" velocity="{end}"'
    )
    (tmp_path / "arm.urdf").write_text(text)
    first = first_graph(str(tmp_path / "arm.urdf"), tmp_path)
    (tmp_path / FIRST).write_text(first.text)
    robot, motion = dm.load(tmp_path / FIRST).robot, motion_of(first)
    wide = replace(motion, ranges=np.tile([-end, end], (4, 1)), rates=np.full(4, end))
    (tmp_path / "limits.yaml").write_text(limits_text(wide, robot))
    found = load_limits(tmp_path / "limits.yaml", robot)
    np.testing.assert_allclose(found.upper, end, rtol=1e-5)
    np.testing.assert_allclose(found.speed, end, rtol=1e-5)


def weak_robot(kinds: str, effort: float) -> str:
    """An arm whose first joint has this limit of effort [N m]."""
    return sliding_robot(kinds).replace('effort="100"', f'effort="{effort}"', 1)


def test_a_posture_is_chosen_in_which_each_joint_can_hold_the_arm(tmp_path: Path) -> None:
    """Without a limit the best posture requires more torque of the first joint than the weak motor has."""
    share = dict[float, float]()
    for effort in (1000.0, 2.0):
        (tmp_path / "arm.urdf").write_text(weak_robot("RRRR", effort))
        first = first_graph(str(tmp_path / "arm.urdf"), tmp_path)
        (tmp_path / FIRST).write_text(first.text)
        chain = dm.load(tmp_path / FIRST).robot
        q = np.array(first_path(first)["center"])
        weight = pin.computeGeneralizedGravity(chain.model, chain.model.createData(), pin_configuration(chain, q))
        share[effort] = abs(float(weight[0])) / 2.0
    assert share[1000.0] > 0.8
    assert share[2.0] < EFFORT


def test_assumed_friction_is_a_small_part_of_the_torque_limits(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(weak_robot("RRRR", 2.0))
    first = first_graph(str(tmp_path / "arm.urdf"), tmp_path)
    (tmp_path / FIRST).write_text(first.text)
    arm = dm.load(tmp_path / FIRST).blocks["arm"]
    np.testing.assert_allclose(arm.coulomb[0], 2.0 * MOST_COULOMB)
    np.testing.assert_allclose(arm.viscous[0], 2.0 * MOST_VISCOUS)
    (tmp_path / "arm.urdf").write_text(weak_robot("RRRR", 1000.0))
    assert first_graph(str(tmp_path / "arm.urdf"), tmp_path).text.count("coulomb: [0.24,") == 0


@pytest.mark.parametrize(
    ("effort", "text"),
    [(0.05, "each law diverges: j1 is at its torque limit, 50 mN m, in .* on the servo pid; .*--payload"), (200.0, "")],
)
def test_a_joint_that_cannot_hold_the_arm_is_named_with_its_limit(effort: float, text: str, tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(weak_robot("RR", effort))
    first = first_graph(str(tmp_path / "arm.urdf"), tmp_path, axes=(2, 7))
    (tmp_path / FIRST).write_text(first.text)
    motion = replace(motion_of(first), seconds=1.0)
    (tmp_path / "race.yaml").write_text(race_text(first, makers(first, 0.1, motion.seconds), motion, 0.008))
    race = load_race(tmp_path / "race.yaml")
    assert re.fullmatch(text, obstacle(race, race.training[0]))


def test_the_adaptive_law_of_a_robot_of_two_joints_is_proved_with_its_rotors(tmp_path: Path) -> None:
    """The rows of the coupled robot have no rotors: with them the proof is refuted."""
    first = first_graph("arm2", tmp_path)
    (tmp_path / FIRST).write_text(first.text)
    motion = motion_of(first)
    (tmp_path / "race.yaml").write_text(race_text(first, makers(first, 0.1, motion.seconds), motion, 0.008))
    race = load_race(tmp_path / "race.yaml")
    graph = race.graph(Run("experts", race.held_out[0], race.laws["experts", 0.008].own, 1))
    arm = {key: value for key, value in race.file.plants["pid"].blocks["arm"].items() if key not in module.LOAD}
    graph = graph.set({"reality": None, "blocks.arm": {**arm, "type": "manipulator"}})
    assert min(graph.blocks["arm"].rotor) > 0
    assert graph.verify().proved
    assert graph.set({"inverse.dynamics": "robot"}).verify().outcome == "refuted"


@pytest.mark.parametrize("seed", [0, 3, 8, 110])
def test_the_motion_of_a_random_chain_is_inside_its_limits_to_both_sides(seed: int, tmp_path: Path) -> None:
    """Seed 0 has a weak motor, for which a posture at a limit has the best reserve of torque."""
    first = first_graph(str(random_chain(tmp_path, seed, untidy=seed > 99)), tmp_path)
    for name, text in first.robot.items():
        (tmp_path / name).write_text(text)
    (tmp_path / FIRST).write_text(first.text)
    joints, path = dm.load(tmp_path / FIRST).robot.joints, first_path(first)
    for joint, center, amplitude in zip(joints, path["center"], path["amplitude"], strict=True):
        assert joint.lower <= center - amplitude < center + amplitude <= joint.upper
