"""The region of kinematic parameters with full-rank Jacobian, compared with closed forms and samples."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from dmframe.analysis import option_value, rank_bound, rank_region
from dmframe.analysis.joint_path import JointPath, joint_path, period_of
from dmframe.analysis.path_tube import path_tube
from dmframe.analysis.rank_bound import MatrixBound, _norm, _size, _spread, _sum, _symmetric, times
from dmframe.analysis.rank_problem import rank_problem
from dmframe.analysis.rank_region import RankRegion
from dmframe.analysis.rank_search import RankSearch
from dmframe.common.errors import MissingError, StartError, ValueFault
from dmframe.diagram import Diagram
from dmframe.exact.enclosure import Enclosure
from dmframe.graph.graph import Graph
from dmframe.simulate import start_state

TUBE = 0.02

TINY = 1e-6
"""Stating a point at which the closed form loses rank."""

ARM2 = """
dmframe: 1
robot: {{model: arm2, axes: xz}}
clock: continuous
duration: 10 s
start: {{q: [{q1}, {q2}]}}
blocks:
  path:     {{type: setpoint, x_d: [{x}, {z}]}}
  geometry: {{type: {geometry}}}
  task:     {{type: known_tracking, gamma: 1}}
  model:    {{type: regressor}}
  dynamics: {{type: dynamic_compensator, Gamma: 1}}
  inverse:  {{type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w_I: 1}}
  servo:    {{type: pi_servo, K_P: 60, K_I: 240}}
  arm:      {{type: manipulator}}
"""
L1, L2 = 0.45, 0.40


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return tmp_path_factory.mktemp("graphs")


def arm2(folder: Any, q1: float, q2: float, **options: Any) -> RankRegion:
    """The two-link arm at rest at (q1, q2); its first joint turns about -y, so z is upwards."""
    x = L1 * math.cos(q1) + L2 * math.cos(q1 + q2)
    z = L1 * math.sin(q1) + L2 * math.sin(q1 + q2)
    path = folder / f"arm_{q1:g}_{q2:g}.yaml"
    path.write_text(ARM2.format(q1=q1, q2=q2, x=repr(x), z=repr(z), geometry="kinematics"))
    graph = Graph.read(path)
    return rank_region(graph.diagram, graph.start, duration=10, **options)


@cache
def packaged(name: str, *overrides: str) -> tuple[Diagram, Any]:
    graph = Graph.read(name, overrides)
    return graph.diagram, graph


def region(name: str, *overrides: str, **options: Any) -> RankRegion:
    diagram, graph = packaged(name, *overrides)
    return rank_region(diagram, graph.start, duration=graph.file.duration, **{"tube": TUBE, "boxes": 300, **options})


@cache
def theorem_3(shape: str) -> RankRegion:
    return region("theorem_3", shape=shape)


def sampled(name: str, found: RankRegion, count: int = 1000, seed: int = 0) -> np.ndarray:
    """Singular values at random poses of the tube and random parameters of the set, half of both on the boundary.

    The Jacobian is Pinocchio's, with joints placed according to the parameters.
    """
    chain = packaged(name)[1].robot
    rng, poses = np.random.default_rng(seed), found.path.poses
    values = np.empty(count)
    model = chain.model.copy()
    frame, data = model.frames[chain.model_tool], model.createData()
    for i in range(count):
        k = rng.integers(max(len(poses) - 1, 1))
        first, last = poses[k], poses[min(k + 1, len(poses) - 1)]
        q = first + rng.random() * (last - first) + found.tube * drawn(rng, len(first), "box")
        a = found.centre + found.half * drawn(rng, len(found.half), found.shape)
        for j in range(chain.n):
            model.jointPlacements[j + 1].translation = a[3 * j : 3 * j + 3]
        frame.placement.translation = a[3 * chain.n :]
        model.frames[chain.model_tool] = frame
        J = pin.computeFrameJacobian(model, data, q, chain.model_tool, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[:3]
        values[i] = np.linalg.svd(J[["xyz".index(axis) for axis in chain.axes]], compute_uv=False)[-1]
    return values


def drawn(rng: np.random.Generator, size: int, shape: str) -> np.ndarray:
    """A point of the unit box or ball, every other time one of its corners or of its boundary."""
    rim = rng.random() < 0.5
    if shape == "box":
        return rng.choice([-1.0, 1.0], size) if rim else rng.uniform(-1, 1, size)
    direction = rng.normal(size=size)
    return direction / np.linalg.norm(direction) * (1.0 if rim else rng.random())


@pytest.mark.parametrize("shape", ["box", "ball"])
def test_no_singular_value_in_the_region_is_below_the_certified_one(shape: Any) -> None:
    found = theorem_3(shape)
    assert found.holds
    assert 0 < found.asked <= found.certified <= np.min(sampled("theorem_3", found))


def test_the_region_is_not_empty_words_and_no_larger_than_what_refutes_it() -> None:
    found = theorem_3("box")
    assert found.fails_at is not None
    assert 0.4 * found.fails_at < found.radius < found.fails_at


def test_known_kinematics_and_redundant_robots_have_a_region_too() -> None:
    for name in ("ur10_fast", "panda_full"):
        diagram, graph = packaged(name)
        found = rank_region(diagram, graph.start, duration=1.0, tube=0.01, boxes=300)
        assert (found.parameters, found.option, found.start_inside) == ("robot.a_k", None, None)
        assert option_value(found) is None
        assert found.radius > 0.01
        assert 0 < found.certified <= np.min(sampled(name, found, count=1000))


def test_what_refutes_a_radius_is_a_singular_value_below_the_required_one() -> None:
    for name, radius, least in (("theorem_3", 0.2, 0.02), ("panda_full", 0.2, 0.02)):
        diagram, graph = packaged(name)
        problem = rank_problem(diagram, graph.start, "truth")
        path = joint_path(problem.reach, problem.start, 2.0, None, 0.05, path_tube(problem.path, 0.05))
        search = RankSearch(problem, path, 0.05, "box", np.ones(len(problem.centre)), 1, lambda text: None)
        refuted = search.witness(radius, least)
        assert refuted is not None
        assert np.max(np.abs(refuted.a - problem.centre)) <= radius * (1 + 1e-12)
        assert path.distance(refuted.q[None])[0] <= 0.05 + 1e-9
        J = search.bound.value(refuted.q, refuted.a, problem.values).full().reshape(problem.expression.shape, order="F")
        singular = np.linalg.svd(J, compute_uv=False)[-1]
        assert singular < least or refuted.singular == 0  # the determinant changed its sign on the way
        assert search.witness(1e-4, least) is None


def test_the_problem_is_that_of_the_loop_that_runs() -> None:
    diagram, graph = packaged("theorem_3")
    loop, found = diagram.loop, list[Any]()
    goals = tuple(leaf.standing_for(1.01 * leaf.expression) for leaf in loop.trajectories)
    shown = tuple(replace(item, expression=1.01 * item.expression) for item in loop.outputs)
    for other in (loop, replace(loop, trajectories=goals), replace(loop, outputs=shown)):
        problem = rank_problem(replace(diagram, loop=other), graph.start, "truth")
        poses = joint_path(problem.reach, problem.start, 2.0, None, 0.05, path_tube(problem.path, 0.05)).poses
        f = ca.Function("J", [problem.q, problem.a, problem.p], [problem.expression])
        found.append((poses, f(problem.start, problem.centre, problem.values).full()))
    (poses, J), (moved, _), (_, larger) = found
    assert poses.shape != moved.shape or np.max(np.abs(poses - moved)) > 1e-4
    np.testing.assert_allclose(larger, 1.01 * J, rtol=1e-12)


# A two-link arm by hand: with the links' vectors p1, p2 in the plane and the angle q2 between them, J loses its rank
# where p1 and R(q2) p2 are parallel. A box of half-width r about (l, 0) turns a vector by up to atan(r / (l - r)).


@pytest.mark.parametrize("q1", [0.0, math.pi / 2, -math.pi / 2])
def test_two_links_at_a_right_angle_have_the_box_of_the_closed_form(folder: Any, q1: float) -> None:
    found = arm2(folder, q1, math.pi / 2, tube=0, least=TINY)
    # tan(a + b) = (r/(l1-r) + r/(l2-r)) / (1 - r^2/((l1-r)(l2-r))) is infinite at (l1-r)(l2-r) = r^2
    largest = L1 * L2 / (L1 + L2)
    assert found.radius == pytest.approx(largest, rel=0.02)
    assert found.radius < largest


def test_lengths_alone_may_be_wrong_by_the_shorter_one(folder: Any) -> None:
    lengths = [0, 0, 0, 1, 0, 0, 1, 0, 0]
    found = arm2(folder, 0.0, math.pi / 2, tube=0, least=TINY, scale=lengths)
    assert found.radius == pytest.approx(L2, rel=0.02)
    assert found.radius < L2
    assert found.fails_at == pytest.approx(L2, rel=0.02)
    assert found.half[np.array(lengths) == 0].tolist() == [0] * 7


@pytest.mark.parametrize("q2", [0.6, 1.2, 2.2, -1.0])
def test_two_links_have_no_larger_box_than_the_closed_form(folder: Any, q2: float) -> None:
    def turned(r: float) -> float:
        return math.atan2(r, L1 - r) + math.atan2(r, L2 - r)

    found = arm2(folder, 0.3, q2, tube=0, least=TINY)
    room = min(abs(q2), math.pi - abs(q2))
    assert turned(found.radius) < room
    assert found.fails_at is not None
    assert found.fails_at == pytest.approx(fitting(turned, room), rel=0.02)
    assert found.radius > 0.4 * found.fails_at


def fitting(turned: Any, room: float) -> float:
    low, high = 0.0, L2
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if turned(middle) < room else (low, middle)
    return low


def test_a_tube_that_reaches_the_stretched_arm_leaves_no_region(folder: Any) -> None:
    found = arm2(folder, 0.3, 0.1, tube=0.11, least=TINY)
    assert found.loss is not None
    assert (found.holds, found.radius, found.loss.kind) == (False, 0, "singular")
    assert "within 0.11 rad of the path" in found.loss.text
    assert arm2(folder, 0.3, 0.1, tube=0.09, least=TINY).holds


def test_a_wider_tube_and_a_larger_bound_leave_a_smaller_region(folder: Any) -> None:
    radii = [
        arm2(folder, 0.0, 1.5, tube=tube, least=least).radius for tube, least in ((0, 0.01), (0.2, 0.01), (0, 0.1))
    ]
    assert radii[0] > radii[1]
    assert radii[0] > radii[2]


def test_a_circle_that_leaves_the_workspace_is_reported_with_the_time() -> None:
    found = region("theorem_3", "path.radius=0.9")
    assert found.loss is not None
    assert (found.holds, found.loss.kind, found.loss.time) == (False, "unreachable", 0)
    assert "the path leaves the workspace at t = 0 s" in found.loss.text
    later = region("theorem_3", "path.radius=0.45", "path.phase=3")
    assert later.loss is not None
    assert later.loss.kind == "unreachable"
    assert 4 < later.loss.time < 5
    assert later.loss.singular < 1e-4


def test_the_joint_path_follows_the_desired_one_and_closes() -> None:
    found = theorem_3("box")
    diagram, _ = packaged("theorem_3")
    (x,) = (s.expression for s in diagram.loop.outputs if s.label == "arm.x")
    (q,) = (v.symbol for v in diagram.loop.plant if v.label == "arm.q")
    at = ca.Function("x", [q, diagram.loop.p], diagram.loop.joined([x]))
    path = found.path
    assert path.period == pytest.approx(4 * math.pi)
    assert path.times[-1] == path.period == path.span
    for time, pose in zip(path.times[path.times > 0], path.poses[path.times > 0], strict=True):
        wanted = [-0.07 + 0.15 * math.sin(0.5 * time), 0.67 + 0.15 * math.cos(0.5 * time), 0.55]
        assert at(pose, diagram.loop.p_values).full().ravel() == pytest.approx(wanted, abs=1e-8)
    assert np.max(np.abs(np.diff(path.poses, axis=0))) <= TUBE / 2 + 1e-12
    assert path.distance(path.poses).max() == 0
    assert path.distance(path.poses + 0.3)[0] <= 0.3


def test_a_path_of_ones_own_may_be_taken_instead() -> None:
    times = np.linspace(0, 1, 30)
    poses = np.array([1.2, -1.5, 1.7]) + 0.1 * np.sin(np.outer(2 * math.pi * times, [1, 2, 3]))
    found = region("theorem_3", path=JointPath(times, poses, 1.0, None, None))
    assert found.path.poses is poses
    assert found.certified <= np.min(sampled("theorem_3", found, count=1000))


def test_a_start_off_the_path_approaches_it() -> None:
    diagram, graph = packaged("theorem_1")
    found = rank_region(diagram, graph.start, duration=20, boxes=200, tube=0.01)
    (first,) = (graph.start["q"],)
    assert found.path.poses[0] == pytest.approx(first)
    assert len(found.path.poses) > 5
    assert (found.path.period, found.path.times.max()) == (0, 0)


def test_the_box_can_be_pasted_into_the_graph_and_lies_inside() -> None:
    found = theorem_3("box")
    value = option_value(found)
    assert value is not None
    lower, upper = np.array(value)
    assert (lower >= found.centre - found.half).all()
    assert (upper <= found.centre + found.half).all()
    assert upper - lower == pytest.approx(2 * found.half, abs=3e-6)
    assert found.option == "geometry.a_k_hat_box"
    diagram, graph = packaged("theorem_3", f"{found.option}={value}")
    assert start_state(diagram, graph.start).size
    again = region("theorem_3", f"{found.option}={value}")
    assert again.radius == pytest.approx(found.radius)


def test_the_ball_can_be_pasted_too_and_an_estimate_outside_is_reported() -> None:
    found = theorem_3("ball")
    value = option_value(found)
    assert value is not None
    assert (found.option, found.start_inside) == ("geometry.a_k_hat_ball", True)
    diagram, graph = packaged("theorem_3", f"{found.option}={value}")
    assert start_state(diagram, graph.start).size
    far = region("theorem_3", "geometry.start_error=90 mm")
    assert far.start_inside is False
    diagram, graph = packaged("theorem_3", "geometry.start_error=90 mm", f"{far.option}={option_value(far)}")
    with pytest.raises(StartError):
        start_state(diagram, graph.start)


def test_the_set_may_lie_about_the_start_and_hold_the_adapted_translations_alone() -> None:
    found = region("theorem_3", "geometry.adapt=tool", "geometry.start_error=10 mm", centre="start")
    assert found.names == ("tool x", "tool y", "tool z")
    tool = [float(x) for x in packaged("theorem_3")[1].robot.tool]
    assert found.centre == pytest.approx(np.array(tool) + 0.01)
    assert found.radius > theorem_3("box").radius


def test_half_widths_are_proportional_to_lengths_with_that_option() -> None:
    found = region("theorem_3", scale="length")
    lengths = np.linalg.norm(found.centre.reshape(-1, 3), axis=1)
    expected = np.repeat(np.maximum(lengths / lengths.max(), 0.1), 3)
    assert found.half == pytest.approx(expected * found.radius)
    assert found.certified <= np.min(sampled("theorem_3", found))


def test_few_boxes_give_a_smaller_region_that_still_holds() -> None:
    found = region("theorem_3", boxes=100)
    assert 0 < found.radius < theorem_3("box").radius
    assert found.certified <= np.min(sampled("theorem_3", found, count=500))


@pytest.mark.parametrize(
    ("angles", "period"),
    [
        (lambda t: [ca.sin(2 * t), ca.cos(2 * t + 1)], math.pi),
        (lambda t: [ca.sin(0.9 * t), ca.cos(1.5 * t)], 2 * math.pi / 0.3),
        (lambda t: [ca.SX(3)], 0.0),
        (lambda t: [ca.sin(t), ca.sin(math.sqrt(2) * t)], None),
        (lambda t: [ca.sin(t) + t], None),
        (lambda t: [ca.sin(t * t)], None),
        (lambda t: [ca.fmin(t, 1)], None),
    ],
)
def test_a_period_is_read_from_the_expression(angles: Any, period: float | None) -> None:
    t = ca.SX.sym("t")
    assert period_of(ca.vertcat(*angles(t)), t) == (period if period is None else pytest.approx(period))


def matrices(q: Any, a: Any) -> list[Any]:
    """A matrix with random entries, and one for which the bound is sharp."""
    rng = np.random.default_rng(1)
    A = [ca.SX(ca.DM(rng.normal(size=(2, 3)))) for _ in range(7)]
    waves = [ca.sin(q[0]), ca.cos(q[1]), a[0], a[1] * ca.sin(q[1]), a[2], ca.sin(q[0] + q[1])]
    mixed = A[0] * 2 + sum((w * M for w, M in zip(waves, A[1:], strict=True)), ca.SX(2, 3))
    return [mixed, ca.horzcat(1 + ca.sum1(a) + ca.sin(q[0]) / 9, 0)]


def violations(shape: Any) -> int:
    """Boxes of q with a singular value below the certified one, at a corner or inside."""
    rng = np.random.default_rng(2)
    q, a, p = ca.SX.sym("q", 2), ca.SX.sym("a", 3), ca.SX.sym("p", 0)
    low = rng.uniform(-2, 2, (300, 2))
    width, half, found = 0.2, np.array([0.1, 0.15, 0.2]), 0
    for matrix in matrices(q, a):
        bound = MatrixBound(matrix, q, a, p, [])
        least = bound.over(low, low + width, np.zeros(3), half, shape).least
        assert np.mean(least > 0) > 0.5
        below = np.zeros(len(low), dtype=bool)
        for _ in range(60):
            within = rng.random(low.shape) if rng.random() < 0.5 else rng.integers(0, 2, low.shape)
            numbers = np.array([half * drawn(rng, 3, shape) for _ in low])
            J = bound.value((low + width * within).T, numbers.T, []).full().T
            J = J.reshape(len(low), bound.columns, bound.rows)
            below |= np.linalg.svd(J, compute_uv=False)[:, -1] < least
        found += int(np.sum(below & (least > 0)))
    return found


@pytest.mark.parametrize("shape", ["box", "ball"])
def test_a_random_matrix_is_bounded_below_everywhere(shape: Any) -> None:
    assert violations(shape) == 0


FAULTS = {
    "the parameters are forgotten": ("_spread", lambda uncertainty, half, shape: 0 * uncertainty[0]),
    "a ball is taken where a box is meant": (
        "_spread",
        lambda uncertainty, half, shape: _spread(uncertainty, half, "ball"),
    ),
    "a norm is half of itself": ("_norm", lambda error: _norm(error) / 2),
    "the inverse is taken for smaller": ("_size", lambda X, U: _size(X, U) / 2),
    "the wrong part of E is taken": ("_symmetric", lambda E: _symmetric(E) if len(E.lower) == 1 else E - _symmetric(E)),
    "the last variable's part of a sum is left out": ("_sum", lambda parts: _sum(parts[:-1])),
    "derivatives are those of the lower ends": ("times", lambda M, X: times(Enclosure.of(M.lower), X)),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_bound_with_a_fault_is_caught(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rank_bound, *FAULTS[fault])
    assert violations("box") > 0


def test_graphs_without_such_a_matrix_and_arguments_out_of_range_are_refused() -> None:
    with pytest.raises(MissingError, match="expected a block with a matrix that must keep full row rank"):
        region("arm2_joint")
    for options, text in (
        ({"tube": -1}, "tube: expected an angle of at least 0 rad, found -1"),
        ({"least": 0}, "least: expected a singular value above 0, found 0"),
        ({"boxes": 0}, "boxes: expected at least 1, found 0"),
        ({"shape": "cone"}, "shape: expected box or ball, found cone"),
        ({"centre": "here"}, "centre: expected truth or start, found here"),
        ({"scale": "odd"}, "scale: expected uniform, length or a number for each parameter, found odd"),
        ({"scale": [1, 2]}, "scale: expected 12 numbers"),
    ):
        with pytest.raises(ValueFault, match=text):
            region("theorem_3", **options)
