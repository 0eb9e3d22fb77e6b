"""``dmframe drive --robot ur:HOST`` against ``dmframe robot``: processes, signals, files."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import pytest
from virtual_robots import Line, Trace, graph, own_host, robot

from dmframe.drive import rehearse, robots
from dmframe.drive.rehearse import Condition
from dmframe.runtime.ur import UniversalRobot
from dmframe.virtual import VirtualRobot

LONG = 60.0
"""Time that one side waits for the other without a fault [s]."""
FAST = 180
"""The sample near the largest joint speed of `ur10_fast`, 0.335 rad/s."""


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.chdir(tmp_path)
    Path("arm.yaml").write_text("dmframe-limits: 1\nacceleration: 40 rad/s^2\n")


def words(host: str, *more: str) -> list[str]:
    own = ["drive", "ur10_fast", "--robot", f"ur:{host}", "--limits", "arm.yaml", "--ramp", "0", "--no-plots"]
    return [*own, "--out", "log", "--seconds", "2 s", "--without-a-passed-rehearsal", *more]


@pytest.fixture
def arm(monkeypatch: pytest.MonkeyPatch) -> VirtualRobot:
    """A robot in this process, instead of one at an address."""
    held = robot(series="cb3")
    monkeypatch.setattr(robots, "UniversalRobot", partial(UniversalRobot, linked=Line(held)))
    return held


def signals(*names: str) -> list[np.ndarray]:
    with h5netcdf.File("log/signals.nc", "r") as file:
        return [np.array(file.variables[name][...]) for name in names]


def off_the_run() -> float:
    """Largest distance of a drive's tool from that of the simulation [m]."""
    x, missed, t = signals("arm.x", "robot.missed", "time")
    assert not missed.any()
    np.testing.assert_allclose(np.diff(t), 0.008, rtol=1e-9)  # no sample twice
    run = graph("ur10_fast").run(2.0, progress=False).recording
    return float(np.abs(x - run["arm.x"][: len(x)]).max())


@pytest.mark.usefixtures("without_v")
def test_it_follows_the_run_and_its_log_is_played_again_identically(dmframe: Any) -> None:
    host = own_host()
    serve = [sys.executable, "-m", "dmframe", "robot", "ur10_fast", "--host", host, "--series", "cb3"]
    with subprocess.Popen([*serve, "--patience", f"{LONG} s"], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            assert "a virtual ur10" in process.stdout.readline()
            reported = dmframe(*words(host, "--patience", f"{LONG} s"))
        finally:
            process.terminate()
        printed = process.stdout.read()
    assert reported.status == 0, reported.err
    assert "measured latency of commands" in reported.out
    assert "dmframe_follow ends: its last line is done" in printed
    assert len(signals("time")[0]) == 251
    assert off_the_run() < 1e-6  # 0.1 mm is required
    reported = dmframe("replay", "log", "ur10_fast")
    assert reported.status == 0
    assert reported.out.startswith("ur10_fast: inverse.dq_c, robot.sent and ")
    assert "of 251 samples of log, recomputed" in reported.out
    assert reported.out.endswith(": identical, bit by bit\n")


@contextmanager
def until(held: VirtualRobot, sample: int) -> Iterator[subprocess.Popen[str]]:
    """A process that drives the robot, synchronised with it, until a sample."""
    host = own_host()
    held.listen(host)
    command = [sys.executable, "-m", "dmframe", *words(host, "--patience", f"{LONG} s")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            begun = held.cycles

            def wanted() -> bool:
                assert process.poll() is None, process.stdout and process.stdout.read()
                return not held.running or held.cycles < begun + sample

            while not held.running:
                assert process.poll() is None
                held.wait(0.01)
                held.advance()
            begun = held.cycles
            held.serve(wanted, LONG)
            yield process
        finally:
            process.kill()


def last_heartbeat(held: VirtualRobot) -> float:
    """Time of the robot's last heartbeat [s]."""
    return held.registers.written["input_int_register_24"] * held.dt


def test_while_a_client_is_frozen_the_arm_comes_to_rest_and_it_reports_it_when_it_wakes() -> None:
    with robot(series="cb3") as held, until(held, FAST) as process:
        trace = Trace(held)
        process.send_signal(signal.SIGSTOP)
        held.advance(30)
        assert trace.rest(last_heartbeat(held)) < 0.1
        assert trace.speed[0] > 0.3
        assert "dmframe_follow ends: its last line is done" in held.messages[-1]
        with held.in_background():
            process.send_signal(signal.SIGCONT)
            reported, _ = process.communicate(timeout=LONG)
    assert process.returncode == 1, reported
    assert "the robot was stopped: robot: its script has ended" in reported
    assert json.loads(Path("log/summary.json").read_text())["interrupted"] is True
    (t,) = signals("time")
    assert len(t) >= FAST - 10
    assert off_the_run() < 1e-6


def test_when_a_client_is_killed_the_arm_comes_to_rest() -> None:
    with robot(series="cb3") as held, until(held, FAST) as process:
        trace = Trace(held)
        process.kill()
        process.wait()
        held.advance(30)
        assert trace.speed[0] > 0.3
        assert trace.rest(last_heartbeat(held)) < 0.1
        assert "dmframe_follow ends: its last line is done" in held.messages[-1]
        assert held.listeners == [trace]  # its connections are gone


@pytest.mark.usefixtures("without_v")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_the_arm_gently_and_all_files_are_there(
    dmframe: Any, arm: VirtualRobot, number: signal.Signals
) -> None:
    class Sent:
        def cycle(self, robot: VirtualRobot) -> None:
            if robot.cycles == FAST:
                os.kill(os.getpid(), number)

    trace = Trace(arm)
    arm.listeners.append(Sent())
    reported = dmframe(*words("arm"))
    name = "Ctrl-C" if number is signal.SIGINT else "SIGTERM"
    assert reported.status == 130
    assert f"the robot was stopped: requested: {name}" in reported.out
    assert np.max(-np.diff(trace.commanded)) / arm.dt == pytest.approx(2.0)
    assert arm.target.still
    assert not arm.running
    files = {path.name for path in Path("log").iterdir()}
    assert files == {"graph.yaml", "provenance.json", "seal.json", "signals.nc", "summary.json"}
    assert json.loads(Path("log/summary.json").read_text())["interrupted"] is True
    assert len(signals("time")[0]) == pytest.approx(FAST, abs=10)


def test_a_log_with_lost_samples_and_a_slider_is_played_again_identically(dmframe: Any, arm: VirtualRobot) -> None:
    class Disturbed:
        def cycle(self, robot: VirtualRobot) -> None:
            robot.slider = 1.0 if robot.cycles < 60 else 0.7
            if robot.cycles in (30, 90):
                robot.lose(2)

    arm.listeners.append(Disturbed())
    reported = dmframe(*words("arm", "--ramp", "0.2 s", "--seconds", "1 s"))
    assert reported.status == 0, reported.err
    assert "4 of " in reported.out
    assert "samples were lost" in reported.out
    assert dmframe("replay", "log", "ur10_fast").out.endswith("identical, bit by bit\n")
    reported = dmframe("replay", "log", "ur10_fast", "--set", "task.gamma=0.9")
    assert reported.status == 1


def test_what_must_be_there_before_an_arm_is_driven(
    dmframe: Any, arm: VirtualRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    rehearsed = [word for word in words("arm", "--seconds", "0.1 s") if word != "--without-a-passed-rehearsal"]
    unlimited = [word for word in rehearsed if word not in ("--limits", "arm.yaml")]
    for given, text in (
        (unlimited, "expected an acceleration limit for a real robot"),
        (rehearsed, "expected a passed rehearsal of exactly this graph, found none"),
    ):
        reported = dmframe(*given)
        assert reported.status == 2
        assert text in reported.err
        assert arm.cycles == 0
    monkeypatch.setattr(rehearse, "conditions", lambda *_: [Condition("nothing, the ideal robot", {})])
    monkeypatch.setattr(rehearse, "LONGEST", 0.4)
    assert dmframe("rehearse", "ur10_fast", "--limits", "arm.yaml", "--ramp", "0").status == 0
    reported = dmframe(*rehearsed)
    assert reported.status == 0, reported.err
    assert dmframe(*rehearsed, "--force", "--set", "task.gamma=0.9").status == 2  # another graph


def test_a_robot_that_is_not_there_or_not_ready_is_one_line(dmframe: Any, arm: VirtualRobot) -> None:
    arm.power_off()
    reported = dmframe(*words("arm"))
    assert reported.status == 2
    assert "ur:arm: the robot was stopped before its first command: robot: it is not ready to move" in reported.err
    assert not Path("log").exists() or not any(Path("log").iterdir())


def test_an_address_without_a_robot_is_one_line(dmframe: Any) -> None:
    reported = dmframe(*words("127.0.0.77"))
    assert reported.status == 2
    assert "127.0.0.77:30004: no robot answers: Connection refused" in reported.err
