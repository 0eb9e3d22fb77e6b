"""The benchmark of designs: what it counts as a fault, and its table."""

from __future__ import annotations

from typing import Any

import pytest

from tests.benchmarks import designs

GOOD = {"name": "a", "axes": 6, "outcome": "adaptive", "law": "experts", "error": 0.2, "run": 0.1, "rival": "level"}
GOOD |= {"rival_error": 0.5, "unit": "mrad", "reason": "", "proof": 0, "status": 0, "cpu": 123.4}


@pytest.mark.parametrize(
    ("changed", "fault"),
    [
        ({"run": None}, "has an error of None"),
        ({"run": 0.5}, "the design states 0.2"),
        ({"proof": 1}, "verify ends with status 1"),
        ({"status": 1}, "exit status 1"),
        ({"outcome": "blocked", "error": None}, "outcome blocked with exit status 0"),
        ({"outcome": "none", "reason": "no end within 600 s"}, "no end within 600 s"),
    ],
)
def test_each_dishonest_end_is_a_fault(changed: dict[str, Any], fault: str) -> None:
    assert list(designs.faults(GOOD)) == []
    (found,) = designs.faults(GOOD | changed)
    assert fault in found


def test_the_table_has_a_row_for_each_robot_and_the_reasons_of_blocked_ones() -> None:
    none = {"name": "b", "outcome": "blocked", "reason": "no arm", "error": None, "unit": "mrad", "cpu": 0.4}
    lines = designs.table([GOOD, none]).splitlines()
    assert lines[2] == "| a | 6 | adaptive | experts | 0.2 | 0.1 | 0.5 (level) | mrad | 123 |"
    assert lines[3] == "| b |  | blocked |  |  |  |  |  | 0.4 |"
    assert lines[-1] == "- b: no arm"


def test_a_design_that_takes_too_long_or_prints_no_result_has_no_outcome(tmp_path: Any) -> None:
    assert designs.designed("none.urdf", tmp_path / "a", 0.01, 1)["reason"] == "no end within 0.01 s"
    found = designs.designed(str(tmp_path / "none.urdf"), tmp_path / "b", 60.0, 1)
    assert (found["outcome"], "none.urdf" in found["reason"]) == ("none", True)
