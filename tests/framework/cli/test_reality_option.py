"""``--reality``: the notices of a run, and the scope of a proof."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.usefixtures("without_v")

Dmframe = Callable[..., Any]

TEXT = """\
dmframe: 1
robot: arm2
clock: 4 ms
duration: 0.2 s
start: {q: [0.7, 1.1]}
blocks:
  path:    {type: sinusoid, center: [0.8, 1.0], amplitude: [0.5, 0.6], rate: [2.0, 3.0]}
  task:    {type: joint_tracking, alpha_bar: 4}
  command: {type: kinematic_command}
  servo:   {type: pi_servo, K_P: [60, 30], K_I: [240, 120]}
  arm:     {type: manipulator, viscous: [1, 0.5]}
"""


def test_a_run_reports_it_and_a_proof_does_not_cover_it(dmframe: Dmframe) -> None:
    Path("plain.yaml").write_text(TEXT, encoding="utf-8")
    reported = dmframe("run", "plain.yaml", "--reality", "none,ur", "--no-plots", "--out", "out")
    assert reported.status == 0
    ideal, real = "plain reality=none: notice: ", "plain reality=ur: notice: "
    assert f"{real}not ideal: command.dq_c through transport_delay, command_limits and command_ramp; " in reported.out
    assert ideal not in reported.out
    saved = Path("out/plain_reality_ur/graph.yaml").read_text(encoding="utf-8")
    assert "encoder: {type: encoder, step: 4.794e-05, window: 0.008" in saved
    again = dmframe("run", "out/plain_reality_ur/graph.yaml", "--no-plots", "--out", "again")
    assert real.partition("not")[2] in again.out
    assert Path("again/graph.yaml").read_text(encoding="utf-8") == saved
    proof = dmframe("verify", "plain.yaml", "--set", "reality=ur")
    assert proof.status == 1
    assert "transport_delay.dq_c_line is a sampled state" in proof.out


def test_an_unknown_set_is_refused(dmframe: Dmframe) -> None:
    reported = dmframe("run", "ur10_slow", "--reality", "abb")
    assert reported.status == 2
    assert reported.err == "dmframe: --set reality=abb: reality abb: unknown set; choose from none, ur\n"
