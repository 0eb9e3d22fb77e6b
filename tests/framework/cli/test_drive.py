"""``dmframe drive``, ``rehearse`` and ``replay``."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dmframe.runtime.simulated import SimulatedRobot

pytestmark = pytest.mark.usefixtures("without_v")


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


def test_a_drive_writes_what_a_run_writes_and_is_played_again(dmframe: Any) -> None:
    reported = dmframe("drive", "ur10_fast", "--robot", "sim", "--seconds", "0.16 s", "--out", "log", "--no-plots")
    assert reported.status == 0, reported.err
    assert "notice: robot: sim\n" in reported.out
    assert reported.out.endswith("results: log\n")
    assert sorted(path.name for path in Path("log").iterdir()) == [
        "graph.yaml",
        "provenance.json",
        "seal.json",
        "signals.nc",
        "summary.json",
    ]
    reported = dmframe("replay", "log", "ur10_fast")
    assert reported.status == 0
    assert reported.out.startswith("ur10_fast: inverse.dq_c, robot.sent and ")
    assert reported.out.endswith("by the compiled engine: identical, bit by bit\n")
    assert "of 21 samples of log, recomputed" in reported.out
    reported = dmframe("replay", "log", "ur10_fast", "--set", "task.gamma=1", "--json")
    assert reported.status == 1
    assert json.loads(reported.out)["identical"] is False


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_the_robot_and_what_was_done_is_kept(
    dmframe: Any, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    stops, reads = list[float](), []
    read, stop = SimulatedRobot.read, SimulatedRobot.stop

    def signalled(self: SimulatedRobot) -> Any:
        reads.append(1)
        if len(reads) == 8:
            os.kill(os.getpid(), number)
        return read(self)

    def noted(self: SimulatedRobot, deceleration: float) -> None:
        stops.append(deceleration)
        stop(self, deceleration)

    monkeypatch.setattr(SimulatedRobot, "read", signalled)
    monkeypatch.setattr(SimulatedRobot, "stop", noted)
    reported = dmframe("drive", "ur10_fast", "--robot", "sim", "--seconds", "1 s", "--out", "log", "--no-plots")
    assert reported.status == 130
    assert stops == [2.0]
    name = "Ctrl-C" if number is signal.SIGINT else "SIGTERM"
    assert f"the robot was stopped: requested: {name}" in reported.out
    assert json.loads(Path("log/summary.json").read_text())["interrupted"] is True


def test_a_signal_before_the_way_to_the_start_moves_nothing(dmframe: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from dmframe.drive import drive

    started, moved, begin = np.array([1.0, -1.0, 1.0]), list[Any](), drive.start_angles

    def signalled(*given: Any) -> Any:  # while the controller is compiled
        os.kill(os.getpid(), signal.SIGINT)
        return begin(*given) + started

    monkeypatch.setattr(drive, "start_angles", signalled)
    monkeypatch.setattr(SimulatedRobot, "move", lambda *given: moved.append(given))
    reported = dmframe("drive", "ur10_fast", "--robot", "sim", "--seconds", "1 s", "--out", "log", "--no-plots")
    assert (reported.status, moved) == (130, [])
    assert "sim: the robot was stopped before its first command: requested: Ctrl-C\n" in reported.err
    assert not Path("log").exists()


def test_a_stop_by_the_gate_has_another_status_and_its_reason(dmframe: Any) -> None:
    Path("arm.yaml").write_text("dmframe-limits: 1\nbox: {y: [0.8 m, 1 m]}\n")
    reported = dmframe(
        "drive", "ur10_fast", "--robot", "sim", "--seconds", "2 s", "--limits", "arm.yaml", "--out", "log", "--no-plots"
    )
    assert reported.status == 1
    assert "the robot was stopped: workspace: coordinate 2 of the tool is at 79" in reported.out


def test_wrong_arguments_are_refused(dmframe: Any) -> None:
    Path("arm.yaml").write_text("dmframe-limits: 1\nacceleration: 15 rad/s^2\n")
    for words, text in (
        (["--robot", "abb"], "--robot abb: unknown kind of robot; "),
        (["--robot", "sim:-1"], "--robot sim:-1: expected a delay of commands in samples"),
        (["--robot", "sim", "--ramp", "-1"], "--ramp -1: expected a number in s of 0 or above"),
        (["--robot", "sim", "--seconds", "0"], "--until 0: expected a time above zero"),
        (["--robot", "ur:x", "--patience", "0"], "--patience 0: expected a time above zero"),
        (["--robot", "ur_rtde", "--limits", "arm.yaml"], "--robot ur_rtde: expected the address of an arm"),
        (["--robot", "sim", "--limits", "none.yaml"], "expected a limits file, found none"),
    ):
        reported = dmframe("drive", "ur10_fast", "--without-a-passed-rehearsal", *words)
        assert reported.status == 2
        assert text in reported.err
        assert not Path("runs").exists() or not any(Path("runs").iterdir())
    reported = dmframe("drive", "pd_torque", "--robot", "sim", "--set", "clock=2 ms")
    assert (reported.status, "expected a graph whose only command is" in reported.err) == (2, True)


def test_a_rehearsal_that_was_cut_short_is_not_kept(dmframe: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from dmframe.drive import rehearse

    given = rehearse.conditions
    monkeypatch.setattr(rehearse, "conditions", lambda *numbers: given(*numbers)[:2])
    reported = dmframe("rehearse", "ur10_fast", "--seconds", "0.4 s")
    assert reported.status == 0
    assert "1 sample of delay, 8 ms" in reported.out
    assert reported.out.endswith("not kept for drive: that requires runs of 40 s\n")
    assert not list(Path("state").rglob("*.json"))
