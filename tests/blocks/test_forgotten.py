"""In industrial tasks, a value that is wrong, missing or without effect is reported before a computation."""

from __future__ import annotations

import errno
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dmframe as dm
from dmframe.catalogue import find_block
from dmframe.cli import _unexpected
from dmframe.common.errors import DmframeError

ARM: dict[str, Any] = {
    "dmframe": 1,
    "robot": "arm2",
    "clock": "8 ms",
    "duration": "40 ms",
    "start": {"q": [0.5, 1.0]},
    "blocks": {
        "path": {"type": "waypoints", "times": [0, 1], "x_d": [[0.5, 0.5], [0.6, 0.5]]},
        "geometry": {"type": "kinematics"},
        "task": {"type": "known_tracking", "gamma": 2},
        "inverse": {"type": "kinematic_command"},
        "servo": {"type": "pi_servo", "K_P": [60, 30], "K_I": [240, 120]},
        "arm": {"type": "loaded_manipulator", "viscous": [1, 0.5]},
    },
}
LOAD = {"blocks.load": {"type": "payload", "mass": [5], "at": [0]}}
SAFE = {"wires.safe.dq_wish": "task.dq_r", "wires.inverse.dq_r": "safe.dq_r"}


def graph(*changes: dict[str, Any]) -> dm.Graph:
    found = dm.load(ARM)
    for change in changes:
        found = found.set(change)
    return found


def notices(found: dm.Graph) -> str:
    return "\n".join(found.run(engine="interpreted", progress=False).notices)


@pytest.mark.parametrize(
    ("blocks", "text"),
    [
        (
            LOAD | {"blocks.arm": {"type": "manipulator", "viscous": [1, 0.5]}},
            "no block reads load.a_load, so that load (payload) has no effect",
        ),
        (
            {"blocks.path": {"type": "setpoint", "x_d": [0.5, 0.5], "orientation": [0, 0, 0]}},
            "no block reads path.p_d, so that it has no effect",
        ),
        (
            {"blocks.pace": {"type": "path_wait"}},
            "so that pace (path_wait) has no effect",
        ),
    ],
)
def test_an_output_without_a_reader_is_reported_by_a_run_and_by_check(blocks: dict[str, Any], text: str) -> None:
    found = graph(blocks)
    assert text in notices(found)
    assert text in str(found)


def test_a_graph_whose_outputs_are_all_read_gives_no_notice() -> None:
    assert not graph(LOAD).diagram.unread


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"lower": 2, "upper": 1}, "a joint is beyond the limits that are to be kept, first at t = 0 s"),
        ({"lower": 2, "upper": 1}, "the margins leave no room between the limits that are to be kept"),
        ({"margin": 10}, "the margins leave no room between the limits that are to be kept"),
    ],
)
def test_limits_that_no_joint_can_keep_are_reported_by_a_run(given: dict[str, Any], text: str) -> None:
    assert text in notices(graph({"blocks.safe": {"type": "safe_reference", **given}} | SAFE))


def test_limits_that_are_kept_give_no_notice() -> None:
    assert "limits that are to be kept" not in notices(graph({"blocks.safe": {"type": "safe_reference"}} | SAFE))


CAMERA = {"position": [0, 0, 0], "right": [1, 0, 0], "down": [0, 1, 0], "ahead": [0, 0, 1]}
BODY = {"mass": [1], "at": [0]}


@pytest.mark.parametrize(
    ("kind", "given", "text"),
    [
        ("payload", BODY | {"inertia": [[1, 0, 1]]}, "inertia: expected rows of 6 numbers in kg m^2, found 3 in [["),
        ("payload", BODY | {"center": [[1]]}, "center: expected rows of 3 numbers in m, found 1 in [[1]]"),
        (
            "setpoint",
            {"x_d": [0, 0], "orientation": [0, 1]},
            "orientation: expected 3 numbers in rad, found 2",
        ),
        ("setpoint", {"chi_d": [0]}, "chi_d: expected 2 numbers, found 1 in [0]"),
        ("turning", {"orientation": [0, 0, 0], "axis": [1e-200, 0, 0]}, "axis: expected a direction, of a length from"),
        ("turning", {"orientation": [0, 0, 0], "axis": [1e200, 0, 0]}, "axis: expected a direction, of a length from"),
        ("wall", {"point": [0, 0], "normal": [0, 1e-200], "stiffness": 1}, "normal: expected a direction, of a length"),
        ("camera", CAMERA | {"ahead": [0, 0, 0]}, "ahead: expected a direction, of a length from"),
        (
            "camera",
            CAMERA | {"down": [-2, 0, 0]},
            "expected directions that do not lie in one plane, found right [",
        ),
    ],
)
def test_numbers_of_another_shape_and_directions_that_are_invalid_are_refused(
    kind: str, given: dict[str, Any], text: str
) -> None:
    with pytest.raises(DmframeError) as caught:
        find_block(kind)(**given)
    assert text in str(caught.value)


@pytest.mark.parametrize("length", [1e-90, 1.0, 1e90])
def test_a_direction_of_any_other_length_is_one(length: float) -> None:
    wall = find_block("wall")(point=[0, 0], normal=[0, length], stiffness=1)
    robot = dm.load(ARM).diagram.robot
    found = wall.evaluate({"q": [math.pi / 2, 0], "dq": [0, 0]}, robot=robot).outputs
    other = find_block("wall")(point=[0, 0], normal=[0, 1], stiffness=1).evaluate(
        {"q": [math.pi / 2, 0], "dq": [0, 0]}, robot=robot
    )
    np.testing.assert_allclose(found["f_ext"], other.outputs["f_ext"], rtol=1e-12)


def test_a_load_unknown_to_the_controller_is_no_part_of_its_export(tmp_path: Path) -> None:
    graph(LOAD).export(tmp_path / "out", "c")
    (header,) = (path.read_text() for path in (tmp_path / "out").glob("*.h") if path.stem != "samples")
    assert "x_d" in header
    assert "load" not in header


@pytest.mark.parametrize(
    ("change", "reads"), [(LOAD, "load.a_load"), ({"arm.payload": [5], "arm.payload_at": [0]}, "the time")]
)
def test_a_robot_that_moves_by_more_than_its_commands_states_by_what(
    change: dict[str, Any], reads: str, tmp_path: Path
) -> None:
    with pytest.raises(DmframeError, match=rf"its commands, found one that reads {reads};"):
        graph(change).export(tmp_path / "out", "fmi3")


def test_an_export_on_a_full_disk_is_reported_as_such(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(DmframeError, match="cannot be written: no space left on device; free some space"):
        graph().export(tmp_path / "out", "c")
    assert not list(tmp_path.iterdir())


def test_a_full_disk_that_cannot_be_reported_is_no_defect() -> None:
    assert _unexpected(OSError(errno.EFBIG, "File too large")).startswith("a file cannot be written: file too large; ")


def test_a_block_with_a_wrong_number_is_not_reported_as_unknown() -> None:
    baseline = {"geometry": None, "other": None}
    with pytest.raises(DmframeError) as caught:
        dm.load(ARM | {"blocks": ARM["blocks"] | {"geometry": {"type": "kinematics", "x": 1}}, "baseline": baseline})
    texts = [str(fault) for fault in caught.value.faults]
    assert any("blocks.geometry.x: unknown parameter" in text for text in texts)
    assert [text for text in texts if "unknown block" in text] == [text for text in texts if "baseline.other" in text]
