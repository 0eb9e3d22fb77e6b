"""The enclosure of a joint path over every time interval, compared with the closed form for two links."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dmframe.analysis import rank_region
from dmframe.analysis.joint_path import JointPath, ToolPath, joint_path, period_of
from dmframe.analysis.path_tube import PathTube, path_tube
from dmframe.common.errors import MissingError
from dmframe.exact.enclosure import Enclosure
from dmframe.graph.graph import Graph

L1, L2 = 0.45, 0.40
START = np.array([0.3, 1.2])
FIRST = np.array([L1 * math.cos(0.3) + L2 * math.cos(1.5), L1 * math.sin(0.3) + L2 * math.sin(1.5)])
DURATION = 100.0
TUBE = 0.05

Way = Callable[[Any], Any]


def follow(way: Way, tube: float = TUBE, duration: float = DURATION) -> JointPath:
    """Two links whose tool moves from FIRST by `way` along x."""
    q, t, p = ca.SX.sym("q", 2), ca.SX.sym("t"), ca.SX.sym("p", 0)
    x = ca.vertcat(L1 * ca.cos(q[0]) + L2 * ca.cos(q[0] + q[1]), L1 * ca.sin(q[0]) + L2 * ca.sin(q[0] + q[1]))
    goal = ca.vertcat(FIRST[0] + way(t), FIRST[1])
    functions = [ca.Function("f", [of], [value]) for of, value in ((q, x), (q, ca.jacobian(x, q)), (t, goal))]
    actual, slope, wanted = (lambda at, f=f: f(at).full() for f in functions)
    reach = ToolPath(lambda at: actual(at).ravel(), slope, lambda at: wanted(at).ravel())
    proof = path_tube((x, q, goal, t, p, []), tube)
    return joint_path(reach, START, duration, period_of(goal, t), tube / 2, proof)


def exact(way: Way, times: np.ndarray) -> np.ndarray:
    """The joint angles with the elbow on one side, by the law of cosines."""
    t = ca.SX.sym("t")
    moved = ca.Function("way", [t], [way(t)])(times[None]).full().ravel()
    x, z = FIRST[0] + moved, FIRST[1]
    q2 = np.arccos((x * x + z * z - L1**2 - L2**2) / (2 * L1 * L2))
    return np.column_stack([np.arctan2(z, x) - np.arctan2(L2 * np.sin(q2), L1 + L2 * np.cos(q2)), q2])


def lies_apart(way: Way, path: JointPath, span: float | None = None) -> bool:
    """True if the exact joint path leaves its enclosure at one of 10 000 times."""
    assert path.line_distance is not None
    span = path.span if span is None else span
    times = np.sort(np.concatenate([np.random.default_rng(0).uniform(0, span, 9000), np.linspace(0, span, 1000)]))
    line = np.column_stack([np.interp(times, path.times, path.poses[:, j]) for j in range(2)])
    segment = np.clip(np.searchsorted(path.times, times) - 1, 0, len(path.line_distance) - 1)
    return bool((np.abs(exact(way, times) - line) > path.line_distance[segment] + 1e-12).any())


def reach_out(t: Any, at: float, how_far: float, lasts: float) -> Any:
    """A path along a triangle and back."""
    return how_far * ca.fmax(0, 1 - ca.fabs(t - at) * 2 / lasts)


HELD: dict[str, Way] = {
    "at rest": lambda t: 0 * t,
    "a circle's share": lambda t: 0.05 * ca.sin(t),
    "two short ways that stay in reach": lambda t: reach_out(t, 20, 0.02, 0.004) + reach_out(t, 73, -0.02, 0.004),
    "pieces that meet": lambda t: ca.if_else(t < 30, 0.001 * t, ca.if_else(t < 70, 0.03, 0.03 + 1e-5 * (t - 70) ** 2)),
    "a remainder without a jump": lambda t: 0.02 * ca.sin(2 * math.pi * ca.fmod(t, 10) / 10),
    "rounded, and put back": lambda t: 0.02 * ca.sin(2 * math.pi * (t / 10 - ca.floor(t / 10))),
    "a smooth step": lambda t: 0.05 * ca.tanh(t - 50),
    "rates that are hardly apart": lambda t: 0.01 * (ca.sin(t) + ca.sin((1 + 1e-13) * t)),
}


@pytest.mark.parametrize("name", HELD)
def test_a_path_that_can_be_followed_lies_where_it_is_claimed_to_lie(name: str) -> None:
    found = follow(HELD[name])
    assert (found.path_exit, found.unproved, found.until) == (None, None, DURATION)
    assert found.line_distance is not None
    assert np.max(found.line_distance) < 0.1 * TUBE
    if found.span:
        assert not lies_apart(HELD[name], found)


@pytest.mark.parametrize(
    ("way", "when"),
    [
        (lambda t: reach_out(t, 38.4, 0.5, 2), 38),
        (lambda t: reach_out(t, 50, 0.5, 0.001), 50),
        (lambda t: reach_out(t, 20, 0.02, 0.004) + reach_out(t, 73, 0.5, 0.004), 73),
        (lambda t: 0.6 * ca.exp(-(((t - 50) / 0.001) ** 2)), 50),
    ],
)
def test_a_short_way_out_of_reach_between_two_rests_is_found(way: Way, when: float) -> None:
    found = follow(way)
    assert found.path_exit is not None
    assert (found.path_exit.time, found.until) == (pytest.approx(when, abs=1), 0)
    assert found.path_exit.distance > 1e-9


@pytest.mark.parametrize(
    ("way", "when"),
    [
        (lambda t: ca.if_else(ca.logic_and(t > 50, t < 50.001), 0.3, 0), 50),
        (lambda t: 0.01 * ca.fmod(t, 7), 7),
        (lambda t: 0.3 * ca.sin(ca.floor(t / 30)), 30),
        (lambda t: 0.1 * ca.sign(t - 60), 60),
    ],
)
def test_a_path_that_jumps_has_no_joint_path(way: Way, when: float) -> None:
    found = follow(way)
    assert found.path_exit is not None
    assert (found.path_exit.time, found.until) == (pytest.approx(when, rel=1e-4), 0)
    assert found.path_exit.jump > 0.01


def test_what_has_no_enclosure_is_not_proved_and_the_reason_is_reported() -> None:
    found = follow(lambda t: 0.01 * ca.log(1 + t), duration=5.0)
    assert found.unproved is not None
    assert (found.unproved.reason, found.until) == (
        "path: expected operations with an enclosure rule, found log",
        0,
    )


def test_a_path_that_only_seems_to_repeat_itself_is_followed_to_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    way: Way = lambda t: 0.02 * ca.sin(t) + reach_out(t, 50, 0.02, 0.01)  # noqa: E731
    monkeypatch.setattr(f"{__name__}.period_of", lambda *_: 2 * math.pi)
    found = follow(way)
    assert (found.period, found.span, found.until) == (None, DURATION, DURATION)
    assert not lies_apart(way, found)


FAULTS: dict[str, tuple[type, str, Callable[..., Any]]] = {}


def _at_the_ends(self: PathTube, *arguments: Any, missed: Any = PathTube._missed) -> Any:
    q, t, v, instants, passed, J = arguments
    there = Enclosure(instants.upper, instants.upper)
    return missed(self, q, t, v, there, Enclosure(passed.upper, passed.upper), J)


FAULTS["the path is looked at where intervals end"] = PathTube, "_missed", _at_the_ends
FAULTS["a step is what it is at the middle of the box"] = (
    PathTube,
    "_matrix",
    lambda self, f, box, n, own=PathTube._matrix: own(
        self, f, Enclosure(*[(box.lower + box.upper) / 2 + 0.5 * (box.upper - box.lower)] * 2), n
    ),
)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_test_with_a_fault_is_caught(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(*FAULTS[fault])
    caught = list[bool]()
    for way in (HELD["two short ways that stay in reach"], lambda t: 0.3 * ca.sin(3 * t) - 0.2):
        q0 = exact(way, np.zeros(1))[0]
        monkeypatch.setattr(f"{__name__}.START", q0)
        found = follow(way, tube=0.4)
        caught.append(found.until == 0 or lies_apart(way, found))
    assert any(caught)


GRAPH = """
dmframe: 1
robot: {{model: arm2, axes: xz}}
clock: continuous
duration: 100 s
start: {{q: [0.3, 1.2]}}
blocks:
  path:     {{type: waypoints, times: [0, 38, 39, 40, 100], x_d: {points}}}
  geometry: {{type: kinematics}}
  task:     {{type: known_tracking, gamma: 1}}
  model:    {{type: regressor}}
  dynamics: {{type: dynamic_compensator, Gamma: 1}}
  inverse:  {{type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w_I: 1}}
  servo:    {{type: pi_servo, K_P: 60, K_I: 240}}
  arm:      {{type: manipulator}}
"""


@pytest.mark.parametrize(("far", "holds"), [(0.01, True), (0.5, False)])
def test_a_reach_between_two_rests_leaves_no_region(far: float, holds: bool, tmp_path: Path) -> None:
    here, there = FIRST.tolist(), [float(FIRST[0]) + far, float(FIRST[1])]
    path = tmp_path / "arm.yaml"
    path.write_text(GRAPH.format(points=[here, here, there, here, here]))
    graph = Graph.read(path)
    diagram = graph.diagram
    found = rank_region(diagram, graph.start, duration=100, boxes=500)
    assert (found.holds, found.model) == (holds, diagram.fingerprint)
    if found.loss is not None:
        assert (found.loss.kind, found.loss.time) == ("unreachable", pytest.approx(38.5, abs=0.5))
    else:
        assert found.until == 100


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("ur10_paced", r"path\.x_d, which also depends on pace\.t_path"),
        ("ur10_admittance", "which a controller block computes from"),
        ("ur10_pose", r"found path\.p_d too"),
    ],
)
def test_a_path_that_the_robot_does_not_walk_is_refused(name: str, why: str) -> None:
    graph = Graph.read(name)
    with pytest.raises(MissingError, match=why):
        rank_region(graph.diagram, graph.start, duration=1)
