"""Runs that leave the joint limits, and errors that grow while all states stay finite."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dmframe as dm
from dmframe.simulate.bounds import LARGEST, bounds_of
from dmframe.simulate.growth import growth

JOINT = (
    '<joint name="j{k}" type="{kind}"><parent link="l{k}"/><child link="l{n}"/><axis xyz="0 0 1"/>'
    '<origin xyz="0.4 0 0"/>{limit}</joint>'
)
LINK = (
    '<link name="l{k}"><inertial><origin xyz="0.2 0 0"/><mass value="2"/><inertia ixx="0.1" iyy="0.1" izz="0.1" '
    'ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
GRAPH = """
dmframe: 1
robot: {{model: arm.urdf, axes: xy}}
clock: 10 ms
duration: {duration} s
blocks:
  path:    {{type: sinusoid, center: [0.1, 0.2], amplitude: [0.1, 0.1], rate: 1}}
  task:    {{type: joint_tracking, alpha_bar: 1e-6}}
  inverse: {{type: kinematic_command}}
  servo:   {{type: pi_servo, K_P: 1, K_I: 0.001}}
  arm:     {{type: manipulator, viscous: 1, coulomb: 0}}
"""


def arm(folder: Path, kind: str, limit: str = "", duration: float = 8.0) -> dm.Graph:
    """A planar arm with two joints, whose velocity servo lags behind its command so much that its error drifts."""
    joints = "".join(JOINT.format(k=k, n=k + 1, kind=kind, limit=limit) for k in (0, 1))
    (folder / "arm.urdf").write_text(
        f'<robot name="arm"><link name="l0"/>{"".join(LINK.format(k=k) for k in (1, 2))}{joints}</robot>'
    )
    (folder / "arm.yaml").write_text(GRAPH.format(duration=duration))
    return dm.load(folder / "arm.yaml")


def columns_of(graph: dm.Graph, time: np.ndarray, error: np.ndarray, path: float = 0.3) -> dict[str, Any]:
    """Signals of the goal: a path of that amplitude, and an error in the first element."""
    goal = graph.diagram.loop.goal
    assert goal is not None
    desired = np.zeros((time.size, 3))
    desired[:, 1] = path * np.sin(time)
    actual = desired.copy()
    actual[:, 0] += error
    return {goal.desired: desired, goal.actual: actual}


def test_positions_are_bounded_by_the_limits_and_once_more_their_range_and_unlimited_joints_are_not() -> None:
    diagram = dm.load("panda_full").diagram
    bounds, at = bounds_of(diagram), 0
    for variable in diagram.loop.variables:
        if variable.label == "arm.q":
            found = bounds[at : at + 7]
        at += variable.symbol.numel()
    joints = diagram.robot.joints
    np.testing.assert_allclose(found, [max(-j.lower, j.upper) + j.upper - j.lower for j in joints])


@pytest.mark.parametrize(("kind", "limit"), [("continuous", ""), ("revolute", '<limit velocity="3" effort="9"/>')])
def test_joints_without_limits_have_no_bound(kind: str, limit: str, tmp_path: Path) -> None:
    diagram = arm(tmp_path, kind, limit).diagram
    rows = [variable.symbol.numel() for variable in diagram.loop.variables]
    at = int(np.sum(rows[: [variable.label for variable in diagram.loop.variables].index("arm.q")]))
    assert (bounds_of(diagram)[at : at + 2] == LARGEST).all()


def test_a_joint_that_leaves_its_limits_is_noticed_and_by_more_than_its_range_has_diverged(tmp_path: Path) -> None:
    limit = '<limit lower="-0.5" upper="0.5" velocity="30" effort="9"/>'
    fast = {"clock": "50 ms", "start.dq": [0.1, 0.0]}
    wide = arm(tmp_path, "revolute", limit).set({**fast, "path.amplitude": [0.6, 0.1], "servo.K_P": 100})
    run = wide.run(judge=False)
    assert run.divergence is None
    assert "j0 is at 7" in next(text for text in run.notices if "leaves the robot's joint limits" in text)
    assert "its limits are -500 mrad and 500 mrad" in " ".join(run.notices)
    far = wide.set({"path.amplitude": [2.0, 0.1]}).run(judge=False)
    assert "beyond 1.5 rad, farther outside of the joint's limits than they are apart, at" in str(far.divergence)
    assert str(far).splitlines()[0].startswith("arm: diverged: arm.q[0]")
    assert far.summary["diverged"] is True


def test_an_error_that_grows_beyond_the_path_has_diverged_although_it_is_finite() -> None:
    graph, time = dm.load("ur10_fast"), np.linspace(0.0, 100.0, 2001)
    diagram = graph.diagram
    growing = growth(diagram, columns_of(graph, time, 0.015 * time), time)
    assert growing is not None
    assert (growing.block, growing.state, growing.element, growing.time) == ("arm", "x", 0, 100.0)
    assert "grows to 1.41 m RMS in the last eighth, more than the 300 mm of a robot at rest" in str(growing)
    within = {
        "less than the path": 0.002 * time,
        "bounded": 1.0 + 0.1 * np.sin(3 * time),
        "decreasing": 1.5 - 0.01 * time,
        "a start off the path": 1.2 * np.exp(-time),
        "less than a tenth of the reach": 1e-4 * time,
    }
    for error in within.values():
        assert growth(diagram, columns_of(graph, time, error), time) is None
    set_point = columns_of(graph, time, 1e-4 * time, path=0.0)
    assert growth(diagram, set_point, time) is None
    assert growth(diagram, columns_of(graph, time, 2e-3 * time, path=0.0), time) is not None


def test_joints_without_limits_that_run_away_have_diverged(tmp_path: Path) -> None:
    graph = arm(tmp_path, "continuous", duration=40.0)
    run = graph.set({"arm.viscous": 0.0, "servo.K_I": 1e-9, "path.rate": 0.3}).set({"servo.K_P": 1e-6})
    away = run.set({"start.dq": [1.0, 0.0]}).run(judge=False)
    assert np.isfinite(away["arm.q"].values).all()
    assert "the error of all elements grows" in str(away.divergence)
