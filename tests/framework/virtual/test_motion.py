"""Response of the controller to commands: the documented laws, and their times."""

from __future__ import annotations

import math

import numpy as np
import pytest
from virtual_robots import robot, runs

from dmframe.virtual import VirtualRobot


def targets(held: VirtualRobot, script: str, cycles: int) -> np.ndarray:
    """Target speeds of the first joint, cycle by cycle."""
    held.load_script(script)
    rows = list[float]()
    for _ in range(cycles):
        held.advance()
        rows.append(float(held.target.qd[0]))
    return np.array(rows)


def test_speedj_ramps_holds_and_after_its_time_ramps_down() -> None:
    found = targets(robot(), "def p():\n speedj([0.2, -0.1, 0, 0, 0, 0], 1.0, 0.3)\n sleep(1)\nend\n", 300)
    dt, t = 0.002, 0.002 * np.arange(1, 301)
    expected = np.minimum(np.minimum(1.0 * t, 0.2), np.maximum(0.2 - 1.0 * (t - 0.3), 0))
    assert np.allclose(found, expected, atol=1e-12)
    assert found[-1] == 0
    assert dt * found.sum() == pytest.approx(0.2 * 0.3, rel=0.01)  # the two ramps have the same length


def test_the_joints_of_speedj_keep_their_proportions() -> None:
    held = robot()
    held.load_script("def p():\n speedj([0.2, -0.1, 0.05, 0, 0, 0], 1.0, 1)\nend\n")
    held.advance(20)
    assert np.allclose(held.target.qd, 0.04 * np.array([1, -0.5, 0.25, 0, 0, 0]))


def test_speedj_without_a_time_returns_when_the_speed_is_reached() -> None:
    held = runs(robot(), "def p():\n speedj([0.1, 0, 0, 0, 0, 0], 0.5)\nend\n")
    assert held.cycles == math.ceil(0.1 / 0.5 / held.dt) + 1  # it returns at the next cycle


def test_stopj_ends_at_rest_in_its_time() -> None:
    script = 'def p():\n speedj([0.2, 0, 0, 0, 0, 0], 10, 0.1)\n stopj(2)\n textmsg("at rest")\nend\n'
    held = runs(robot(), script)
    resting = next(text for text in held.messages if "at rest" in text)
    assert float(resting.split()[0]) == pytest.approx(0.1 + 0.2 / 2, abs=2 * held.dt)
    assert held.target.still


@pytest.mark.parametrize(
    ("acceleration", "speed", "time"), [(1.4, 0.5, 0.4 / 0.5 + 0.5 / 1.4), (1.0, 5.0, 2 * 0.4**0.5)]
)
def test_movej_takes_the_time_of_a_trapezoid(acceleration: float, speed: float, time: float) -> None:
    held = robot()
    goal = held.q + np.array([0.4, -0.2, 0.1, 0, 0, 0])
    held = runs(held, f"def p():\n movej({goal.tolist()}, a={acceleration}, v={speed})\nend\n")
    assert held.time == pytest.approx(time, abs=8 * held.dt)
    assert np.allclose(held.target.q, goal, atol=1e-12)


def test_movej_in_a_given_time() -> None:
    held = robot()
    goal = held.q + np.array([0.3, 0, 0, 0, 0, 0])
    held = runs(held, f"def p():\n movej({goal.tolist()}, t=1.2)\nend\n")
    assert held.time == pytest.approx(1.2, abs=8 * held.dt)


def test_movel_goes_along_a_straight_line() -> None:
    held = robot("ur10_full")
    start = held.arm.pose(held.q)
    goal = start + np.array([0.0, 0.0, 0.05, 0, 0, 0])
    held.load_script(f"def p():\n movel(p{goal.tolist()}, a=1, v=0.2)\nend\n")
    while held.running:
        held.advance()
        pose = held.arm.pose(held.target.q)
        assert np.allclose(pose[:2], start[:2], atol=1e-8)
        assert np.allclose(pose[3:], start[3:], atol=1e-7)
    assert pose[2] == pytest.approx(goal[2], abs=1e-9)


def test_servoj_closes_what_is_left_as_an_exponential() -> None:
    held = robot()
    start, goal = held.q[0], held.q + np.array([0.02, 0, 0, 0, 0, 0])
    held.load_script(f"def p():\n servoj({goal.tolist()}, t=0.2, lookahead_time=0.1)\nend\n")
    held.advance(100)
    assert (goal[0] - held.target.q[0]) / (goal[0] - start) == pytest.approx(math.exp(-2), rel=1e-9)


def test_speedl_moves_the_flange_as_commanded() -> None:
    held = robot("ur10_full")
    held.load_script("def p():\n speedl([0, 0, 0.05, 0, 0, 0], 1.0, 0.5)\nend\n")
    held.advance(200)
    speed = held.arm.jacobian(held.target.q) @ held.target.qd
    assert np.allclose(speed, [0, 0, 0.05, 0, 0, 0], atol=2e-4)


def test_the_slider_scales_targets() -> None:
    whole, half = robot(), robot(slider=0.5)
    script = "def p():\n speedj([0.2, 0, 0, 0, 0, 0], 10, 1)\nend\n"
    for held in (whole, half):
        held.load_script(script)
        held.advance(50)
    assert half.target.qd[0] == 0.5 * whole.target.qd[0] == 0.1


def test_a_joint_follows_its_target() -> None:
    held = runs(robot(), "def p():\n speedj([0.2, 0, 0, 0, 0, 0], 1, 0.5)\n stopj(2)\n sleep(0.5)\nend\n")
    assert np.max(np.abs(held.q - held.target.q)) < 5e-3
    assert np.max(np.abs(held.dq)) < 5e-3
    assert held.q[0] - 1.455411 == pytest.approx(0.02 + 0.06 + 0.01, abs=3e-3)  # up, on, down


def test_two_threads_do_not_move_the_robot_at_once() -> None:
    script = """def p():
  thread one():
    speedj([0.1, 0, 0, 0, 0, 0], 1, 1)
  end
  it = run one()
  sync()
  stopj(2)
end
"""
    held = runs(robot(), script)
    assert "line 7: thread one already moves the robot" in held.messages[-1]


def test_a_killed_motion_slows_down() -> None:
    script = """def p():
  thread one():
    speedj([0.1, 0, 0, 0, 0, 0], 1, 10)
  end
  it = run one()
  sleep(0.5)
  kill it
  sleep(0.5)
end
"""
    held = runs(robot(), script)
    assert held.target.still
    assert 0.04 < held.q[0] - 1.455411 < 0.06


def test_a_secondary_program_runs_next_to_another_and_must_not_move_the_robot() -> None:
    held = robot()
    held.load_script("def p():\n speedj([0.1, 0, 0, 0, 0, 0], 1, 1)\nend\n")
    held.advance(10)
    held.load_script("sec other():\n set_digital_out(1, True)\n stopj(1)\nend\n")
    held.advance()
    assert held.digital_outputs == 2
    assert held.messages[-1].endswith(
        "other ends: line 3: a secondary program must not move the robot; begin it with def"
    )
    assert held.running
    assert held.target.qd[0] > 0
