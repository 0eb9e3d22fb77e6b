"""``verify --claim FILE`` and ``python -m dmframe.prove FILE``."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest


def checked(path: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "dmframe.prove", str(path)], capture_output=True, text=True, check=False
    )


def test_a_written_claim_is_checked_again_and_a_false_one_is_not_accepted(dmframe: Any, tmp_path: Path) -> None:
    reported = dmframe("verify", "arm2_joint", "--claim", "claim.json")
    assert reported.status == 0
    assert "wrote claim.json" in reported.out
    path = tmp_path / "claim.json"
    done = checked(path)
    assert done.returncode == 0, done.stderr
    assert "the identity holds; error below 2^-" in done.stdout
    assert "17 of 17 seeded faults refuted" in done.stdout

    found = json.loads(path.read_text())
    next(node for node in reversed(found["program"]["nodes"]) if node[0] == "sub")[0] = "add"
    path.write_text(json.dumps(found))
    done = checked(path)
    assert (done.returncode, done.stderr) == (1, "")
    assert "the identity does not hold: dV/dt" in done.stdout

    path.write_text("{}")
    done = checked(path)
    assert done.returncode == 2
    assert "a claim: expected the format of `to_json`" in done.stderr


def test_v_of_zero_is_not_accepted(dmframe: Any, tmp_path: Path) -> None:
    assert dmframe("verify", "pendulum", "--claim", "claim.json").status == 0
    found = json.loads((tmp_path / "claim.json").read_text())
    for part in found["parts"]:
        part.update(stored=[], dissipation=[], residual=[], consumed=None, lemma="", memories=[], supply="")
    found["composed"] = []
    (tmp_path / "claim.json").write_text(json.dumps(found))
    done = checked(tmp_path / "claim.json")
    assert done.returncode == 2
    assert "a claim: expected a part with a stored term" in done.stderr


@pytest.mark.parametrize(
    ("words", "reports"),
    [
        (("pendulum", "arm2_joint", "--claim", "c.json"), "--claim: expected one graph, found 2"),
        (("ur10_fast_kinematic", "--claim", "c.json"), "--claim: ur10_fast_kinematic has no claim: "),
        (("pendulum", "--claim", "none/c.json"), "none"),
    ],
)
def test_without_a_single_claim_to_write_this_is_reported(
    dmframe: Any, tmp_path: Path, words: tuple[str, ...], reports: str
) -> None:
    reported = dmframe("verify", *words)
    assert reported.status == 2
    assert reports in reported.err
    assert not list(tmp_path.glob("**/c.json"))
