"""A desired path out of reach: found by one instant, with the distance; never where the tool can be."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import dmframe as dm
from dmframe.certify import verify
from dmframe.certify.reach import reach_conditions
from dmframe.certify.samples import sampled_claim_of
from dmframe.robot.library import find_robot
from dmframe.units import plain


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
    """Of the tool from the first joint, by Pinocchio, over a grid of poses."""
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
def test_a_goal_out_of_reach_is_told_with_distance_and_reach(share: float, farthest: float) -> None:
    goal = _center() + share * farthest * np.array([0.6, 0.8])
    verdict = following({"type": "setpoint", "x_d": goal.tolist()}).verify().verdict
    assert verdict.outcome == "not_applicable"
    assert f"path.x_d is {plain(share * farthest, 'm')} from the first joint at t = 0 s" in verdict.reason
    assert f"reaches no farther than {plain(farthest, 'm')}" in verdict.reason


def test_a_path_that_leaves_the_reach_later_is_told_with_the_time(farthest: float) -> None:
    path = {"type": "circle", "center": _center().tolist(), "radius": 0.9 * farthest, "rate": 1}
    assert far(following(path)) == []
    (said,) = far(following(path | {"center": (_center() + np.array([0.2 * farthest, 0])).tolist()}))
    assert f"path.x_d is {plain(1.1 * farthest, 'm')} from the first joint" in said


def test_a_sampled_law_may_not_follow_what_is_out_of_reach_either() -> None:
    from dmframe.config.experiment import load_experiment

    diagram = load_experiment("ur10_slow_sampled", ("path.radius=3",)).diagram()
    (said,) = [item.name for item in reach_conditions(sampled_claim_of(diagram).base)]
    assert said.startswith("path.x_d is ")


def test_a_loop_without_a_robot_or_without_a_tools_path_has_no_reach() -> None:
    for name in ("pendulum", "arm2_joint"):
        from dmframe.certify import claim_of

        assert list(reach_conditions(claim_of(dm.load(name).diagram))) == []
    assert verify(dm.load("arm2_joint").diagram).outcome == "proved"
