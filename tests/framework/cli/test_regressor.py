"""``dmframe regressor``: entries, proofs, files, faults."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def test_entries_are_printed_with_their_parameters(dmframe: Any) -> None:
    reported = dmframe("regressor", "arm2", "--base", "--symbolic")
    assert (reported.status, reported.err) == (0, "")
    assert "  Y_d[1, I_yy2] = ddq_ref_1 + ddq_ref_2\n" in reported.out
    kinematic = dmframe("regressor", "arm2", "--kinematic", "--symbolic").out
    assert kinematic.startswith(
        "arm2: 9 kinematic parameters [m], zero if no value is given: p_x1, p_y1, p_z1, p_x2 = "
    )
    assert "  Y_k[2, p_x3] = c_12 psi_1 + c_12 psi_2\n" in kinematic


def test_files_are_written_with_their_distance_from_pinocchio(dmframe: Any, tmp_path: Path) -> None:
    reported = dmframe("regressor", "arm2", "--python", "y.py", "--latex", "y.tex", "--c", "y.c")
    assert reported.status == 0
    for name in ("y.py", "y.tex"):
        (line,) = (line for line in reported.out.splitlines() if line.startswith(f"wrote {name}; "))
        assert float(line.split()[-1]) < 1e-12
    assert {path.name for path in tmp_path.iterdir()} == {"y.py", "y.tex", "y.c"}
    assert r"M_{22} &= I_{yy2}" in (tmp_path / "y.tex").read_text()


def test_proofs_are_printed_one_a_line(dmframe: Any) -> None:
    reported = dmframe("regressor", "arm2", "--prove")
    assert reported.status == 0
    assert reported.out.count("proved, error probability below 2^-") == 9
    assert "REFUTED" not in reported.out


def test_a_robot_too_large_to_print_writes_nothing(dmframe: Any, tmp_path: Path) -> None:
    reported = dmframe("regressor", "ur10", "--latex", "y.tex", "--c", "y.c")
    assert reported.status == 2
    assert reported.err.startswith("dmframe: ur10: expected at most 3 joints to write out, found 6, whose Y_d takes ")
    assert list(tmp_path.iterdir()) == []
