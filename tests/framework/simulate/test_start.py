"""Initial state of a run: at rest, on the path, gravity compensated, commands at the robot's position."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import dmframe as dm
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.port import Input, Output, Side, State
from dmframe.common.errors import StartError, ValueFault
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.simulate import simulate, start_state
from dmframe.simulate.start import goal_and_place, joint_goal, on_path
from dmframe_plants.arm2 import closed_form

GRAPH = """\
dmframe: 1
robot: arm2
clock: 4 ms
duration: 2 s
blocks:
  goal:    {type: setpoint, q_d: [0.6, 0.9]}
  task:    {type: joint_tracking, alpha_bar: 2}
  inverse: {type: kinematic_command}
  servo:   {type: pi_servo, K_P: [60, 30], K_I: [240, 120]}
  arm:     {type: manipulator, viscous: [1, 0.5], K: [2, 3]}
"""
PID = ("{type: pi_servo, K_P: [60, 30], K_I: [240, 120]}", "{type: pid_servo, K_D: 60, K_P: 180, K_I: 100}")
TASK = (
    "  goal:    {type: setpoint, q_d: [0.6, 0.9]}\n  task:    {type: joint_tracking, alpha_bar: 2}\n",
    "  goal:    {type: setpoint, x_d: [0.5, 0.4]}\n  geometry: {type: kinematics}\n"
    "  task:     {type: known_tracking, gamma: 1}\n",
)


def graph(folder: Path, *changes: tuple[str, str]) -> Graph:
    text = GRAPH
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "g.yaml").write_text(text)
    return Graph.read(folder / "g.yaml")


def begin(folder: Path, *changes: tuple[str, str], **given: Any) -> dict[str, np.ndarray]:
    loop = (diagram := graph(folder, *changes).diagram).loop
    state, found = start_state(diagram, given), dict[str, np.ndarray]()
    for variable in loop.variables:
        found[variable.label], state = state[: variable.symbol.numel()], state[variable.symbol.numel() :]
    return found


@pytest.mark.parametrize("servo", [PID[0], PID[1]], ids=["pi", "pid"])
def test_a_robot_whose_reference_is_constant_does_not_move(servo: str, tmp_path: Path) -> None:
    made = graph(tmp_path, (PID[0], servo))
    run = simulate(made.diagram, 2.0, clock=0.004)
    np.testing.assert_allclose(run["arm.q"], np.tile([0.6, 0.9], (run.time.size, 1)), atol=1e-12)
    np.testing.assert_allclose(run["servo.u"], run["arm.g"] / [2, 3], rtol=1e-12)


def test_the_integrator_holds_gravity_and_the_command_starts_where_the_robot_is(tmp_path: Path) -> None:
    found = begin(tmp_path)
    np.testing.assert_allclose(found["servo.i"], -closed_form.gravity_torque(np.array([0.6, 0.9])) / [480, 360])
    np.testing.assert_allclose(found["servo.q_c"], [0.6, 0.9])


@pytest.mark.parametrize("name", ["arm2_joint", "ur10_fast"])
def test_a_run_begins_at_rest_with_both_references_at_the_measured_pose(name: str) -> None:
    made = Graph.read(name)
    run = simulate(made.diagram, 0.1, clock=made.file.clock, solver=made.solver, start=made.start)
    assert np.all(run["arm.dq"][0] == 0)
    np.testing.assert_array_equal(run["servo.q_c"][0], run["arm.q"][0])
    np.testing.assert_array_equal(run["inverse.q_r"][0], run["arm.q"][0])


def test_a_task_starts_on_its_path_in_the_branch_that_is_near(tmp_path: Path) -> None:
    up, down = begin(tmp_path, TASK, near=[-0.2, 1.8])["arm.q"], begin(tmp_path, TASK, near=[1.6, -1.8])["arm.q"]
    np.testing.assert_allclose(closed_form.position(up), [0.5, 0.4], atol=1e-9)
    np.testing.assert_allclose(closed_form.position(down), [0.5, 0.4], atol=1e-9)
    assert up[1] > 0 > down[1]


def test_given_values_have_precedence_over_the_path_and_over_the_blocks_own(tmp_path: Path) -> None:
    found = begin(tmp_path, q=[0.1, 0.2], dq=0.3, **{"servo.i": [1, 2]})
    np.testing.assert_array_equal(found["arm.q"], [0.1, 0.2])
    np.testing.assert_array_equal(found["arm.dq"], [0.3, 0.3])
    np.testing.assert_array_equal(found["servo.i"], [1, 2])
    np.testing.assert_array_equal(found["servo.q_c"], [0.1, 0.2])


def test_a_matrix_starts_at_one_number_or_at_its_rows() -> None:
    graph = Graph.read("observed_tracking_forgetting_pi", ["geometry.adapt=tool"])
    diagram = graph.diagram

    def begun(G_k: Any) -> np.ndarray:
        run = simulate(diagram, 0.008, clock=0.008, start={**graph.start, "G_k": G_k})
        return np.asarray(run["geometry.G_k"][0]).reshape(3, 3, order="F")

    np.testing.assert_array_equal(begun(0.5), np.full((3, 3), 0.5))
    np.testing.assert_array_equal(begun([[1, 2, 3], [4, 5, 6], [7, 8, 9]]), np.arange(1, 10).reshape(3, 3))
    with pytest.raises(ValueFault, match=r"start\.G_k: expected one number, or 3 rows of 3, found 3"):
        begun([1, 2, 3])


def test_a_pose_out_of_reach_or_of_the_limits_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        StartError, match=r"start: arm\.x cannot reach goal\.x_d\(0\) = \[5, 0\.4\]; the nearest pose is"
    ):
        begin(tmp_path, TASK, ("x_d: [0.5,", "x_d: [5,"))
    with pytest.raises(StartError, match=r"start\.q: expected joint1 between -3\.1 and 3\.1, found 4"):
        begin(tmp_path, q=[4, 0])
    with pytest.raises(ValueFault, match=r"start\.near: expected 2 finite numbers, found 3"):
        begin(tmp_path, TASK, near=[1, 2, 3])


class Follower(AbstractBlock):
    """Starts at the initial value of its input."""

    side = Side.PLANT
    inputs = (Input("a"),)
    outputs = (Output("b"),)
    states = (State("z", sampled=True),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations({"b": x.z}, next={"z": 0.5 * u.a})

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, Any]:
        return {"z": 2 * u.a + 1}


class Leader(AbstractBlock):
    """Starts at three."""

    side = Side.PLANT
    outputs = (Output("b"),)
    states = (State("y"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations({"b": x.y}, {"y": 0 * x.y})

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, Any]:
        return {"y": ca.SX(3)}


def test_starts_are_found_in_the_order_in_which_they_need_one_another_whatever_the_files() -> None:
    blocks = {"last": Follower(), "middle": Follower(), "first": Leader()}
    diagram = Diagram.build(blocks, {"last.a": "middle.b", "middle.a": "first.b"})
    assert [variable.block for variable in diagram.loop.variables] == ["last", "middle", "first"]
    np.testing.assert_array_equal(start_state(diagram, {}), [15, 7, 3])


def test_starts_that_depend_on_one_another_are_reported() -> None:
    diagram = Diagram.build({"one": Follower(), "two": Follower()}, {"one.a": "two.b", "two.a": "one.b"})
    with pytest.raises(StartError) as caught:
        start_state(diagram, {})
    assert str(caught.value) == ("start: one.z and two.z depend on each other's start; give one of them under start")
    np.testing.assert_array_equal(start_state(diagram, {"two.z": 4}), [9, 4])


def test_a_goal_of_the_joints_needs_no_search_and_is_what_scipy_finds(tmp_path: Path) -> None:
    """A search in which SciPy's least squares compute the pose, as for a goal of a task."""
    from scipy.optimize import least_squares

    diagram, made = graph(tmp_path).diagram, dict[Any, Any]()
    ((followed, unknown),) = on_path(diagram, [], made)
    goal_now, residual = goal_and_place(diagram.loop, followed, unknown, made)
    p, goal = diagram.loop.p_values, np.array([0.6, 0.9])
    np.testing.assert_array_equal(goal_now(0, p).full().ravel(), goal)
    found = joint_goal(residual, residual.jacobian(), goal, p)
    sought = least_squares(
        lambda q: residual(q, p).full().ravel() - goal, [0.3, 0.3], xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    np.testing.assert_allclose(found, sought.x, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    "place",
    [lambda q: ca.cos(q), lambda q: q[0] + q[1], lambda q: ca.vertcat(q[0] + q[1], 2 * q[0] + 2 * q[1])],
    ids=["not affine", "fewer than joints", "singular"],
)
def test_a_goal_with_no_or_with_several_poses_gives_no_pose(place: Any) -> None:
    q, p = ca.SX.sym("q", 2), ca.SX.sym("p", 1)
    residual = ca.Function("residual", [q, p], [place(q)])
    goal = np.zeros(residual.numel_out(0))
    assert joint_goal(residual, residual.jacobian(), goal, np.zeros(1)) is None


def test_a_pose_of_the_joints_beyond_their_limits_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StartError, match=r"arm\.q cannot reach goal\.q_d\(0\) = \[0\.6, 9\]"):
        begin(tmp_path, ("q_d: [0.6, 0.9]", "q_d: [0.6, 9]"))


def test_a_run_to_a_goal_of_the_joints_does_not_import_the_search() -> None:
    code = "import sys, dmframe as dm; dm.load('pendulum').run(1); print('scipy' in sys.modules)"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert process.stdout.strip() == "False"


def test_a_start_far_off_the_path_causes_a_notice() -> None:
    """The path starts at its centre, (45, 60) deg, and moves from there by up to 30 and 40 deg in a second."""
    graph = dm.load("arm2_joint")
    run = graph.set({"start": {"q": [0.0, 0.0]}}).run("1 s")
    gap = np.linalg.norm(np.radians([45, 60]))
    extent = np.linalg.norm(np.radians([30, 40]) * np.sin([0.9, 1.4]))
    (notice,) = [text for text in run.notices if "start=null" in text]
    found = re.fullmatch(r"arm.q starts ([\d.]+) rad from path.q_d, which moves by ([\d.]+) mrad in .*", notice)
    assert found is not None
    np.testing.assert_allclose([float(found[1]), float(found[2]) / 1000], [gap, extent], rtol=5e-3)
    near = {"start": {"q": list(np.radians([45 + 12, 60]))}}  # a third of the extent
    for other in (graph, graph.set(near)):
        assert not [text for text in other.run("1 s").notices if "start=null" in text]


def test_null_removes_the_start() -> None:
    graph = Graph.read("ur10_fast", ["start=null"])
    assert graph.start == {}
    assert graph == Graph.read("ur10_fast", ["start={}"])
    assert dm.load("ur10_fast").start != {}
