"""``verify --certificate FILE``."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import dmframe.checker as of_certificates


def test_the_command_writes_it_and_refuses_what_is_not_proved(dmframe: Any, tmp_path: Path) -> None:
    said = dmframe("verify", "arm2_joint", "--certificate", "arm.json")
    assert said.status == 0
    assert "wrote arm.json" in said.out
    data = json.loads((tmp_path / "arm.json").read_text())
    assert data["about"]["graph"] == "arm2_joint"
    checker = Path(of_certificates.__file__).with_name("check.py")
    done = subprocess.run([sys.executable, checker, tmp_path / "arm.json"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")

    said = dmframe("verify", "ur10_fast_kinematic", "--certificate", "k.json")
    assert "a certificate: expected a proved graph, found not_applicable" in said.err
    said = dmframe("verify", "pendulum", "arm2_joint", "--certificate", "k.json")
    assert "--certificate: expected one graph, found 2" in said.err
    assert not (tmp_path / "k.json").exists()
