"""Files of limits: their keys, and every fault with its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import dmframe as dm
from dmframe.common.errors import DmframeError, DriveError
from dmframe.drive import load_limits, own_limits

ROBOT = dm.load("ur10_fast").robot


def test_without_a_file_they_are_the_models() -> None:
    found = own_limits(ROBOT)
    np.testing.assert_array_equal(found.speed, [2.16, 2.16, 3.15])
    np.testing.assert_allclose(found.upper, [2 * np.pi, 2 * np.pi, np.pi])
    assert (found.acceleration, found.box) == (None, None)


def test_a_file_narrows_them(tmp_path: Path) -> None:
    file = tmp_path / "arm.yaml"
    file.write_text(
        "dmframe-limits: 1\n"
        "speed: {elbow_joint: 60 deg/s}\n"
        "acceleration: 4 rad/s^2\n"
        "position: {shoulder_lift_joint: [-180 deg, 0]}\n"
        "box: {z: [5 cm, 1.2 m]}\n"
        "deceleration: 3\n"
        "halt: 12 rad/s^2\n"
        "deviation: 5 deg\n"
        "lost: 2\n"
    )
    found = load_limits(file, ROBOT)
    np.testing.assert_allclose(found.speed, [2.16, 2.16, np.pi / 3])
    assert found.acceleration is not None
    np.testing.assert_array_equal(found.acceleration, [4, 4, 4])
    np.testing.assert_allclose([found.lower[1], found.upper[1]], [-np.pi, 0])
    assert found.box is not None
    np.testing.assert_array_equal(found.box, [[-np.inf, -np.inf, 0.05], [np.inf, np.inf, 1.2]])
    assert (found.deceleration, found.halt, found.lost) == (3.0, 12.0, 2)
    assert found.deviation == pytest.approx(np.pi / 36)


def test_one_speed_for_all_joints_raises_none_above_its_own(tmp_path: Path) -> None:
    file = tmp_path / "arm.yaml"
    file.write_text("dmframe-limits: 1\nspeed: 3 rad/s\n")
    np.testing.assert_array_equal(load_limits(file, ROBOT).speed, [2.16, 2.16, 3.0])


def test_all_faults_are_reported_at_once_with_their_places(tmp_path: Path) -> None:
    file = tmp_path / "arm.yaml"
    file.write_text(
        "dmframe-limits: 2\n"
        "speed: {elbow_joint: 9 rad/s, elbow_jiont: 1}\n"
        "acceleration: {elbow_joint: -4}\n"
        "position:\n"
        "  elbow_joint: [-200 deg, 1]\n"
        "  shoulder_pan_joint: [1, -1]\n"
        "box: {w: [0, 1], x: 3}\n"
        "deceleration: 2 m/s^2\n"
        "halt: 0\n"
        "lost: -1\n"
        "sped: 1\n"
    )
    with pytest.raises(DmframeError) as raised:
        load_limits(file, ROBOT)
    message = str(raised.value).splitlines()
    for line, text in zip(
        message,
        [
            "1:17: dmframe-limits: expected 1",
            "2:22: speed.elbow_joint: expected at most 3.15 rad/s, the robot's limit, found 9 rad/s",
            "2:31: speed.elbow_jiont: unknown joint; did you mean elbow_joint?",
            "3:15: acceleration: expected a number for each joint, found none for shoulder_pan_joint",
            "3:29: acceleration.elbow_joint: expected a positive number in rad/s^2, found -4",
            "5:16: position.elbow_joint: expected angles within the robot's -3.14159265 to 3.14159265 rad",
            "6:23: position.shoulder_pan_joint: expected the minimum first",
            "7:7: box.w: unknown coordinate; choose from x, y, z",
            "7:21: box.x: expected the minimum and the maximum, [0.1, 0.8], found 3",
            "8:15: deceleration: expected a quantity in rad/s^2, found '2 m/s^2'",
            "9:7: halt: expected 100 mrad/s^2 to 1000 rad/s^2, found 0",
            "10:7: lost: expected a whole number from 0 to 1000, found -1",
            "11:1: sped: unknown key; did you mean speed?",
        ],
        strict=True,
    ):
        assert text in line.replace(f"{file}:", ""), (text, line)


def test_a_graph_without_a_robot_has_no_limits() -> None:
    with pytest.raises(DriveError, match="expected a graph with a robot, whose limits apply to commands, found none"):
        own_limits(None)


@pytest.mark.parametrize("number", ["1e-300", "0.01 rad/s^2", "1e300", "-2"])
@pytest.mark.parametrize("key", ["halt", "deceleration"])
def test_a_stop_that_would_not_end_or_that_no_arm_can_do_is_refused(key: str, number: str, tmp_path: Path) -> None:
    file = tmp_path / "arm.yaml"
    file.write_text(f"dmframe-limits: 1\n{key}: {number}\n")
    with pytest.raises(DmframeError, match=f"{key}: expected 100 mrad/s.2 to 1000 rad/s.2, found"):
        load_limits(file, ROBOT)
