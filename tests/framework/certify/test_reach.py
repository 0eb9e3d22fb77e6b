"""An unreachable desired path: found at one instant, with the distance; never if the tool can reach it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import dmframe as dm
from dmframe.certify import verify
from dmframe.certify.claim import claim_of
from dmframe.certify.reach import reach_conditions
from dmframe.certify.shell import shell_of
from dmframe.common.units import plain
from dmframe.robot.chain import SerialChain
from dmframe.robot.library import find_robot


def following(path: dict[str, Any], axes: str | None = None) -> dm.Graph:
    made = {
        "dmframe": 1,
        "robot": {"model": "arm2", **({"axes": axes} if axes else {})},
        "clock": "continuous",
        "duration": "4 s",
        "start": {"q": [0.5, 0.9]},
        "blocks": {
            "path": path,
            "geometry": {"type": "kinematics"},
            "task": {"type": "known_tracking", "gamma": 1},
            "model": {"type": "regressor"},
            "dynamics": {"type": "dynamic_compensator", "Gamma": 1},
            "inverse": {"type": "pi_inverse", "Lambda": 0.01, "Lambda_I": 1, "w_I": 4, "w_I_box": [1, 10]},
            "servo": {"type": "pi_servo", "K_P": [60, 30], "K_I": [240, 120]},
            "arm": {"type": "manipulator", "viscous": 1},
        },
    }
    return dm.load(made)


def far(graph: dm.Graph) -> list[str]:
    from dmframe.certify import claim_of

    return [item.name for item in reach_conditions(claim_of(graph.diagram))]


@pytest.fixture(scope="module")
def farthest() -> float:
    """Distances of the tool from the first joint, by Pinocchio, over a grid of poses."""
    robot = following({"type": "setpoint", "x_d": [0.5, 0.1]}).diagram.robot
    model = pin.buildModelFromUrdf(str(find_robot("arm2").urdf))
    data, tool = model.createData(), np.array([float(x) for x in robot.tool])
    found = []
    for second in np.linspace(-np.pi, np.pi, 721):
        pin.forwardKinematics(model, data, np.array([0.3, second]))
        found.append(np.linalg.norm(data.oMi[2].act(tool) - data.oMi[1].translation))
    return float(max(found))


@pytest.mark.parametrize("share", [0.1, 0.9, 0.9999])
def test_what_the_tool_reaches_is_never_called_out_of_reach(share: float, farthest: float) -> None:
    center = _center()
    goal = center + share * farthest * np.array([0.6, 0.8])
    assert far(following({"type": "setpoint", "x_d": goal.tolist()})) == []


def _center() -> np.ndarray:
    chain = following({"type": "setpoint", "x_d": [0.5, 0.1]}).diagram.robot
    return np.array([float(chain.joints[0].translation["xyz".index(axis)]) for axis in chain.axes])


@pytest.mark.parametrize("share", [1.0001, 3.0])
def test_a_goal_out_of_reach_is_reported_with_distance_and_reach(share: float, farthest: float) -> None:
    goal = _center() + share * farthest * np.array([0.6, 0.8])
    verdict = following({"type": "setpoint", "x_d": goal.tolist()}).verify().verdict
    assert verdict.outcome == "not_applicable"
    assert f"path.x_d is {plain(share * farthest, 'm')} from the first joint at t = 0 s" in verdict.reason
    assert f"reaches no farther than {plain(farthest, 'm')}" in verdict.reason


def test_a_path_that_leaves_the_reach_later_is_reported_with_the_time(farthest: float) -> None:
    path = {"type": "circle", "center": _center().tolist(), "radius": 0.9 * farthest, "rate": 1}
    assert far(following(path)) == []
    (reported,) = far(following(path | {"center": (_center() + np.array([0.2 * farthest, 0])).tolist()}))
    assert f"path.x_d is {plain(1.1 * farthest, 'm')} from the first joint" in reported


def test_a_sampled_law_may_not_follow_what_is_out_of_reach_either() -> None:
    from dmframe.graph.graph import Graph

    diagram = Graph.read("ur10_slow_sampled", ("path.radius=3",)).diagram
    (reported,) = [item.name for item in reach_conditions(claim_of(diagram))]
    assert reported.startswith("path.x_d is ")


def test_a_loop_without_a_robot_or_without_a_tools_path_has_no_reach() -> None:
    for name in ("pendulum", "arm2_joint"):
        from dmframe.certify import claim_of

        assert list(reach_conditions(claim_of(dm.load(name).diagram))) == []
    assert verify(dm.load("arm2_joint").diagram).outcome == "proved"


def test_a_run_has_a_notice_of_a_path_that_leaves_the_reach_while_it_lasts() -> None:
    moving = {"type": "circle", "center": [0.4, 0.2], "radius": 0.05, "rate": "1 rad/s"}
    for path, expected in (({**moving, "radius": 5.0}, 1), (moving, 0)):
        graph = following(path)
        notices = [text for text in graph.run(until=0.05).notices if "no controller can track it there" in text]
        assert len(notices) == expected, notices


BODY = '<inertial><mass value="2"/><inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.025"/></inertial>'
TURNS, SLIDES = "revolute", "prismatic"
CHAINS: dict[str, tuple[str, list[tuple[str, str, str, str]], float, float]] = {
    # task axes; joints: kind, xyz, rpy, axis; inner and outer bound by hand
    "planar, offset along its axes": (
        "xz",
        [(TURNS, "0.7 0.2 1.1", "0 0 0", "0 1 0"), (TURNS, "0.4 0.1 0.2", "0 0 0", "0 1 0")],
        abs(np.hypot(0.4, 0.2) - np.hypot(0.3, 0.1)),
        np.hypot(0.4, 0.2) + np.hypot(0.3, 0.1),
    ),
    "turned base in space": (
        "xyz",
        [(TURNS, "0.7 -0.4 1.1", "0.3 0.2 0.5", "0 0 1"), (TURNS, "0.2 0.1 0.9", "0.7 0 0", "0 1 0")],
        np.sqrt(0.86) - np.hypot(np.hypot(0.3, 0.05), 0.1),
        np.sqrt(0.86) + np.hypot(np.hypot(0.3, 0.05), 0.1),
    ),
    "SCARA": (
        "xyz",
        [
            (TURNS, "0.1 0 0.3", "0 0 0", "0 0 1"),
            (TURNS, "0.6 0 0", "0 0 0", "0 0 1"),
            (SLIDES, "0.1 0 0", "0 0 0", "0 0 1"),
        ],
        0.6 - np.hypot(0.4, 0.05),
        0.6 + np.hypot(0.4, 0.05),
    ),
    "slide, turn, slide along one line": (
        "xyz",
        [
            (SLIDES, "0.1 0.2 0.3", "0 0 0", "1 0 0"),
            (TURNS, "0 0.3 0", "0 0 0", "1 0 0"),
            (SLIDES, "0 0.3 0", "0 0 0", "1 0 0"),
        ],
        np.hypot(0.35, 0.1),
        np.hypot(0.35, 0.1),
    ),
}


def chain_of(name: str, folder: Path) -> Path:
    links = "".join(f'<link name="l{k}">{BODY}</link>' for k in range(len(CHAINS[name][1])))
    joints = "".join(
        f'<joint name="j{k}" type="{kind}"><parent link="{f"l{k - 1}" if k else "base"}"/><child link="l{k}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
        '<limit lower="-2" upper="2" effort="100" velocity="3"/></joint>'
        for k, (kind, xyz, rpy, axis) in enumerate(CHAINS[name][1])
    )
    last = len(CHAINS[name][1]) - 1
    tool = (
        f'<link name="tool"/><joint name="fixed" type="fixed"><parent link="l{last}"/><child link="tool"/>'
        '<origin xyz="0.3 0.05 0.1"/></joint>'
    )
    path = folder / "made.urdf"
    path.write_text(f'<robot name="made"><link name="base"/>{links}{joints}{tool}</robot>', encoding="utf-8")
    return path


@pytest.mark.parametrize("name", CHAINS)
def test_the_shell_is_that_by_hand_and_holds_what_pinocchio_reaches(name: str, tmp_path: Path) -> None:
    axes, joints, inner, outer = CHAINS[name]
    path = chain_of(name, tmp_path)
    model = pin.buildModelFromUrdf(str(path))
    data, tool, rng = model.createData(), model.getFrameId("tool"), np.random.default_rng(0)
    shell = shell_of(Chained(SerialChain.from_urdf(path, tool="tool", axes=axes)))
    assert shell is not None
    assert (shell.inner, shell.outer) == pytest.approx((inner, outer), rel=1e-8)
    assert shell.slides is any(kind == SLIDES for kind, *_ in joints)
    sizes = []
    for q in rng.uniform(-np.pi, np.pi, (3000, len(joints))):
        pin.framesForwardKinematics(model, data, q)
        place = data.oMf[tool].translation[["xyz".index(axis) for axis in axes]]
        sizes.append(float(np.linalg.norm(shell.across @ (place - shell.center))))
    assert shell.inner <= min(sizes)
    assert max(sizes) <= shell.outer
    if name != "turned base in space":  # for whose second axis no pose aligns the offsets
        assert min(sizes) < inner + 0.05
        assert outer - 0.05 < max(sizes)


@dataclass(frozen=True)
class Chained:
    """The data of a robot that `shell_of` reads."""

    chain: SerialChain


@pytest.mark.parametrize(("share", "expected"), [(0.9, 1), (1.1, 0)])
def test_a_goal_nearer_than_a_planar_arm_folds_is_out_of_reach(share: float, expected: int) -> None:
    goal = _center() + share * 0.05 * np.array([0.6, 0.8])  # links of 0.45 and 0.4 m
    reported = [
        text for text in far(following({"type": "setpoint", "x_d": goal.tolist()})) if "comes no nearer than" in text
    ]
    assert len(reported) == expected


def test_a_slide_behind_joints_about_different_axes_has_no_shell(tmp_path: Path) -> None:
    joints = [
        (TURNS, "0 0 1", "0 0 0", "0 0 1"),
        (TURNS, "0 0 1", "0 0 0", "0 1 0"),
        (SLIDES, "1 0 0", "0 0 0", "1 0 0"),
    ]
    CHAINS["free"] = ("xyz", joints, 0.0, 0.0)
    path = chain_of("free", tmp_path)
    del CHAINS["free"]
    assert shell_of(Chained(SerialChain.from_urdf(path, tool="tool", axes="xyz"))) is None
