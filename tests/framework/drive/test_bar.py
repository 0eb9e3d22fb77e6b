"""Error bounds of a rehearsal: a tolerance, or a stationary robot and the kinematic inverse of J."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import dmframe as dm
from dmframe.common.errors import DmframeError
from dmframe.drive.error_bounds import ErrorBounds, Measured, farthest, quarters
from dmframe.drive.rehearse import Condition, Rehearsal, rehearsed
from dmframe.drive.rival import Rival, law_of
from dmframe.runtime.robot import Sample

IDEAL = Condition("nothing, the ideal robot", {})
LATE = Condition("2 samples of delay", {"delay": 2})
LAW = """
from typing import ClassVar, final
import casadi as ca
from dmframe.block import AbstractBlock, Equations
from dmframe.block.parameter import Positive, Scalar
from dmframe.block.port import Input, Output

@final
class My(AbstractBlock):
    inputs = (
        Input("q", "n", "rad"), Input("q_d", "n", "rad"), Input("t", "", "s"),
        Input("dq_d", "n", "rad/s", derivative_of="q_d"),
    )
    outputs = (Output("dq_r", "n", "rad/s"),)
    rate: Scalar = Positive("", "1/s")

    def equations(self, u, x, p):
        return Equations(outputs={"dq_r": @LAW@})
"""
GRAPH = """
dmframe: 1
robot: arm2
clock: 10 ms
duration: 3 s
blocks:
  path: {type: sinusoid, center: [45 deg, 60 deg], amplitude: [30 deg, 40 deg], rate: [0.9 rad/s, 1.4 rad/s]}
  task: {type: "my.py:My", rate: 2}
  inverse: {type: kinematic_command}
  servo: {type: pi_servo, K_P: [60, 30], K_I: [240, 120]}
  arm: {type: manipulator, viscous: [1, 0.5]}
"""


def written(folder: Path, law: str, more: str = "") -> dm.Graph:
    (folder / "my.py").write_text(LAW.replace("@LAW@", law))
    (folder / "graph.yaml").write_text(GRAPH + more)
    return dm.load(folder / "graph.yaml")


def tried(graph: dm.Graph, *conditions: Condition) -> Rehearsal:
    return rehearsed(graph, engine="interpreted", tried=[*(conditions or (IDEAL,))])


WRONG = {
    "the wrong sign, and no path": "p.rate * 0.01 * u.q",
    "nothing at all": "0 * u.q",
    "half of the feed-forward": "0.5 * u.dq_d - 0.3 * (u.q - u.q_d)",
    "a constant offset": "u.dq_d - p.rate * (u.q - u.q_d - 0.2)",
    "the path of a moment before": "u.dq_d - p.rate * (u.q - u.q_d) - 0.2 * u.dq_d",
}


@pytest.mark.parametrize("what", WRONG)
def test_a_law_that_does_not_do_its_task_fails_on_the_ideal_robot(tmp_path: Path, what: str) -> None:
    found = tried(written(tmp_path, WRONG[what]))
    assert not found.passed
    assert found.sentence.startswith("graph may not drive a robot: on the ideal robot, ")


def test_the_kinematic_law_itself_passes_and_is_its_own_rival(tmp_path: Path) -> None:
    graph = written(tmp_path, "u.dq_d - p.rate * (u.q - u.q_d)")
    found = tried(graph, IDEAL, LATE)
    assert found.passed, str(found)
    for outcome in found.outcomes:
        assert outcome.error == pytest.approx(outcome.rival, rel=1e-6)
    assert found.bar.rival == "kinematic command at the joints, 2 1/s"
    message = found.summary
    assert message["conditions"][0]["rival"] == found.outcomes[0].rival
    assert message["conditions"][0]["still"] == pytest.approx(0.6, rel=0.5)
    assert "rival: kinematic command at the joints, 2 1/s; stationary robot: " in str(found)


def test_a_tolerance_decides_alone_in_each_condition(tmp_path: Path) -> None:
    good = "u.dq_d - p.rate * (u.q - u.q_d)"
    error = tried(written(tmp_path, good)).outcomes[0].error
    assert error is not None
    wide = tried(written(tmp_path, "u.dq_d - 0.3 * (u.q - u.q_d)", "tolerance: 200 mrad\n"))
    assert wide.passed
    assert "tolerance of the graph: 200 mrad" in str(wide)
    narrow = tried(written(tmp_path, good, f"tolerance: {0.9 * error * 1e3} mrad\n"), IDEAL, LATE)
    assert [bool(item.why) for item in narrow.outcomes] == [True, True]
    assert narrow.outcomes[0].why.startswith("the tolerance is ")
    assert narrow.summary["tolerance"] == pytest.approx(0.9 * error)


@pytest.mark.parametrize("law", ["0 * u.q", "ca.vertcat(ca.sin(9 * u.t), ca.cos(7 * u.t))"])
def test_a_tolerance_that_holding_still_meets_decides_nothing(tmp_path: Path, law: str) -> None:
    found = tried(written(tmp_path, law, "tolerance: 2 rad\n"))
    assert not found.passed
    assert "is within the tolerance of 2 rad: set a smaller one, or a start off the goal" in found.sentence


@pytest.mark.parametrize("before", ["0 * u.q", "ca.vertcat(ca.sin(3 * u.t), ca.sin(5 * u.t))"])
@pytest.mark.parametrize("more", ["", "tolerance: 100 mrad\n"])
def test_a_law_that_follows_in_the_last_quarter_alone_fails(tmp_path: Path, before: str, more: str) -> None:
    found = tried(written(tmp_path, f"ca.if_else(u.t < 2, {before}, u.dq_d - 12 * (u.q - u.q_d))", more))
    assert not found.passed
    assert "quarter is " in found.sentence


def test_a_path_that_is_back_at_its_start_in_the_end_is_judged_where_it_was_away() -> None:
    away = Measured("", "m", 0.001, 0.001, 0.001, 0.0005, "", moved=0.2)
    assert not ErrorBounds(0.002, "", "").above(away, None, ideal=True)
    assert "third quarter is 200 mm" in ErrorBounds(0.002, "", "").above(replace(away, third=0.2), None, ideal=True)


def test_a_tolerance_that_is_invalid_is_refused(tmp_path: Path) -> None:
    for text, message in (
        ("-2 mm", "expected a positive error"),
        ("2 kg", "expected a positive error"),
        ("0", "positive"),
    ):
        with pytest.raises(DmframeError, match=message):
            written(tmp_path, "u.dq_d", f"tolerance: {text}\n")
    with pytest.raises(DmframeError, match=r":\d+:\d+: tolerance: expected a quantity in rad, found '2 mm'"):
        _ = written(tmp_path, "u.dq_d", "tolerance: 2 mm\n").diagram  # without a run, as `check` does


def test_a_goal_out_of_reach_does_not_pass() -> None:
    graph = dm.load("filtered_regulation_pi").set(
        {"path.x_d": [0.5, 2.5, 0.5], "duration": "2 s", "clock": "8 ms", "solver.step": "8 ms"}
    )
    found = tried(graph)
    assert not found.passed
    assert "on the ideal robot, " in found.sentence


@pytest.mark.parametrize(
    ("name", "why"),
    [("ur10_pose", "the task includes an orientation"), ("ur10_paced", "path.x_d is not a function of time only")],
)
def test_without_a_fair_rival_a_tolerance_is_required(name: str, why: str) -> None:
    graph = dm.load(name)
    assert law_of(graph) == (None, why)
    run = Measured("", "m", 0.001, 0.001, 0.001, 0.2, "")
    assert (
        ErrorBounds(None, "", why).above(run, None, ideal=True)
        == f"no rival is applicable ({why}): set a tolerance in the graph"
    )
    assert not ErrorBounds(0.002, "", why).above(run, None, ideal=True)


GOOD = Measured("e", "m", 0.01, 0.0021, 0.002, 0.2, "")


@pytest.mark.parametrize(
    ("rms", "still", "rival", "message"),
    [
        (0.002, 0.2, GOOD, ""),
        (0.0021, 0.2, GOOD, ""),  # the variation of the rival itself between quarters
        (0.00211, 0.2, GOOD, "the error of the rival is 2 mm"),
        (0.002, 0.0039, GOOD, "the error of a stationary robot is 3.9 mm; at most half of it is allowed"),
        (0.002, 0.0, GOOD, "the error of a stationary robot is 0 m"),
        (0.002, 0.2, replace(GOOD, stopped="command too fast"), "the rival does not follow either: set a tolerance"),
        (0.002, 0.2, replace(GOOD, last=0.15), "the rival does not follow either: set a tolerance"),
        (np.nan, 0.2, GOOD, "the error of a stationary robot"),
    ],
)
def test_the_bar_is_half_of_a_stationary_robot_and_the_rival(
    rms: float, still: float, rival: Measured, message: str
) -> None:
    run = Measured("e", "m", rms, rms, rms, still, "")
    found = ErrorBounds(None, "rival", "").above(run, rival, ideal=True)
    assert found.startswith(message)
    assert bool(found) == bool(message)


def test_under_a_condition_that_stops_the_rival_too_holding_still_remains() -> None:
    run, stopped = Measured("e", "m", 0.01, 0.01, 0.01, 0.2, ""), replace(GOOD, stopped="cuts")
    assert not ErrorBounds(None, "rival", "").above(run, stopped, ideal=False)
    assert ErrorBounds(None, "rival", "").above(replace(run, last=0.11), stopped, ideal=False)


def test_quarters_are_those_of_the_whole_time() -> None:
    shares = np.arange(8) / 8
    found = quarters(shares, np.array([9, 9, 1, 1, 2, 2, 3, 3.0]), np.full(8, 5.0))
    assert found == (1.0, 2.0, 3.0, 5.0)
    assert farthest(shares, np.array([9, 9, 1, 1, 7, 7, 3, 3.0])) == 7.0


def test_the_rival_is_the_kinematic_law_by_hand() -> None:
    graph = dm.load("ur10_fast")
    law, _ = law_of(graph)
    assert law is not None
    assert law.gain == 1.0  # the graph's own, 0.8 J J', is smaller
    rival, q = Rival(law, 3, 0.008), np.array([1.4, -1.0, 1.0])
    x = law.shown(q)[0].full().ravel()
    assert rival.step(Sample(0.0, q, np.zeros(3), x=x), 0.3, 1.0)
    small = 1e-6
    jacobian = np.stack(
        [
            (law.shown(q + small * axis)[0].full() - law.shown(q - small * axis)[0].full()).ravel() / (2 * small)
            for axis in np.eye(3)
        ],
        axis=1,
    )
    start = law.goal(0.0)[0].full().ravel() - [-0.07, 0.67, 0.55]
    turn = np.arctan2(start[1], start[0])
    angles = (turn + 0.3, turn - 0.3)
    circles = [np.array([-0.07, 0.67, 0.55]) + 0.15 * np.array([np.cos(a), np.sin(a), 0]) for a in angles]
    found = law.goal(0.3)[0].full().ravel()
    which = int(np.argmin([np.abs(found - circle).max() for circle in circles]))
    np.testing.assert_allclose(found, circles[which], atol=1e-12)
    sense = 1 if which == 0 else -1
    rate = sense * 0.15 * np.array([-np.sin(angles[which]), np.cos(angles[which]), 0])
    wanted = circles[which]
    np.testing.assert_allclose(jacobian @ rival.command, rate - (x - wanted), atol=1e-6)
