"""Closed loops that are stable by theory: the identity is never refuted, and the error bound is small."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest
from closed_loops import FRICTION, loop_of, odd_chain
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dmframe.certify import claim_of, verify
from dmframe.certify.assemble import assembled
from dmframe.exact import ZeroTest
from dmframe.graph.graph import Graph
from dmframe.prove import identity as exact
from dmframe.robot.library import load

ROBOTS = {
    "arm2": ("arm2", {}),
    "ur10 with 3 joints": (
        "ur10",
        {
            "free": ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"],
            "hold": {"wrist_2_joint": -1.5707963},
            "tool": "ee_link",
        },
    ),
    "xarm7": ("xarm7", {}),
}
LOOPS = [(task, servo) for task in ("task", "joint") for servo in ("PI", "PID")]


@cache
def robot(name: str) -> Any:
    model, options = ROBOTS[name]
    return load(model, **options)


def identity(diagram: Any) -> ZeroTest:
    return exact.identity(assembled(claim_of(diagram)), trials=1, seed=7)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_identity_holds_for_every_servo_and_every_reference_with_and_without_boxes(name: str) -> None:
    turn = list(ROBOTS).index(name)  # each robot meets each kind of friction, in another combination
    for k, (task, servo) in enumerate(LOOPS):
        friction = list(FRICTION)[(k + turn) % 4]
        test = identity(loop_of(robot(name), task, servo, friction=friction, boxes=(k + turn) % 3 == 0).build())
        assert test.zero, (name, task, servo, friction)
        assert test.log2_error_bound < -78


@pytest.mark.parametrize("friction", FRICTION)
@pytest.mark.parametrize(("task", "servo"), LOOPS)
def test_the_planar_arm_is_proved_with_every_friction_with_and_without_boxes(
    task: str, servo: str, friction: str
) -> None:
    boxes = (LOOPS.index((task, servo)) + list(FRICTION).index(friction)) % 2 == 0
    test = identity(loop_of(robot("arm2"), task, servo, friction=friction, boxes=boxes).build())
    assert test.zero


@pytest.mark.parametrize("source", ["setpoint", "circle", "waypoints"])
def test_every_path_of_the_tool_is_proved(source: str) -> None:
    assert verify(loop_of(robot("arm2"), "task", "PID", source=source, boxes=True).build()).outcome == "proved"


@pytest.mark.parametrize("source", ["setpoint", "sinusoid", "waypoints"])
def test_every_path_of_the_joints_is_proved(source: str) -> None:
    assert verify(loop_of(robot("arm2"), "joint", "PI", source=source, boxes=True).build()).outcome == "proved"


def test_a_robot_of_seven_joints_is_proved_in_full() -> None:
    verdict = verify(loop_of(robot("xarm7"), "task", "PID", boxes=True).build())
    assert (verdict.outcome, verdict.reason.split(",")[0]) == ("proved", "dV/dt equals minus the dissipation")
    assert verdict.test is not None
    assert verdict.test.log2_error_bound < -200
    assert len(verdict.controls) >= 25
    assert all(control.refuted for control in verdict.controls)


@pytest.mark.parametrize("name", ["pendulum", "arm2_joint", "ur10_fast_tuned"])
def test_packaged_graphs_are_proved(name: str) -> None:
    assert verify(Graph.read(name).diagram).outcome == "proved"


@settings(max_examples=6, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.lists(st.sampled_from(["revolute", "revolute", "prismatic"]), min_size=1, max_size=4),
    st.sampled_from(LOOPS),
    st.sampled_from(list(FRICTION)),
    st.booleans(),
    st.integers(0, 2**31),
)
def test_no_random_chain_is_refuted(
    kinds: list[str], loop: tuple[str, str], friction: str, boxes: bool, seed: int
) -> None:
    n = len(kinds)
    chain = odd_chain(n, seed, "xyz"[: min(n, 3)], kinds)
    test = identity(loop_of(chain, *loop, friction=friction, boxes=boxes).build())
    assert test.zero
    assert test.log2_error_bound < -78
