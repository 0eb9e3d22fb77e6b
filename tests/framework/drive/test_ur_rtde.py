"""The driver by ur_rtde: with a test double of the package, and with the package if it is installed."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from drivers import driven
from virtual_robots import Trace, graph, own_host, robot

import dmframe as dm
from dmframe.common.errors import DriveError, LostError, MissingError
from dmframe.drive.robots import Options, kind_of
from dmframe.runtime.ur_rtde import CALLS, UrRtde

LIMIT = 120.0
"""Time limit of a client [s]; it needs some seconds."""
INSTALLED = importlib.util.find_spec("rtde_control") is not None
needs_ur_rtde = pytest.mark.skipif(not INSTALLED, reason="needs ur_rtde: python -m pip install ur_rtde")


class Package:
    """Test double of the package: an arm that executes commands at once, with a sample for each poll of the clock."""

    def __init__(self) -> None:
        self.values: dict[str, Any] = dict(zip(CALLS, [100.0, *3 * [None], 1.0, 1.0, 7, 1, 1], strict=True))
        self.values |= {"actual_q": [1.455411, -1.016031, 0.978316, 0, -np.pi / 2, 0], "actual_qd": [0.0] * 6}
        self.values["target_q"] = list(self.values["actual_q"])
        self.called, self.torn, self.silent, self.step, self.takes = list[tuple[Any, ...]](), False, False, 0.008, True

    def sleep(self, _: float) -> None:
        if not self.silent:
            self.values["timestamp"] += self.step

    def receive(self, *given: Any) -> Any:
        self.called.append(("receive", *given))
        made = {call: (lambda name=name: self.values[name]) for name, call in CALLS.items()}

        def speed_fraction() -> float:
            if self.torn:  # a sample arrives while values are read
                self.torn = False
                self.values["timestamp"] += self.step
                self.values["actual_qd"] = [9.0] * 6
            return 1.0

        made["getTargetSpeedFraction"] = speed_fraction
        return SimpleNamespace(**made, isConnected=lambda: True, disconnect=lambda: self.called.append(("gone",)))

    def control(self, *given: Any) -> Any:
        self.called.append(("control", *given))
        self.values["runtime_state"] = 2

        def noted(name: str, answer: Any = True) -> Any:
            return lambda *words: (self.called.append((name, *words)), answer() if callable(answer) else answer)[1]

        names = ("setWatchdog", "speedStop", "stopJ", "stopScript", "isProgramRunning", "disconnect", "kickWatchdog")
        return SimpleNamespace(
            **{name: noted(name) for name in names}, speedJ=noted("speedJ", lambda: self.takes), moveJ=self.moved
        )

    def moved(self, goal: list[float], *given: Any) -> bool:
        self.called.append(("moveJ", goal, *given))
        self.values["target_q"] = self.values["actual_q"] = goal
        return True


@pytest.fixture
def package(monkeypatch: pytest.MonkeyPatch) -> Package:
    held, now = Package(), [0.0]

    def sleep(seconds: float) -> None:
        now[0] += seconds
        held.sleep(seconds)

    monkeypatch.setitem(sys.modules, "rtde_receive", SimpleNamespace(RTDEReceiveInterface=held.receive))
    monkeypatch.setitem(sys.modules, "rtde_control", SimpleNamespace(RTDEControlInterface=held.control))
    monkeypatch.setattr(time, "sleep", sleep)
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return held


def driver() -> UrRtde:
    own = graph("ur10_fast")
    made = kind_of("ur_rtde:arm")[0].make("arm", own, Options(1.0))
    assert isinstance(made, UrRtde)
    return made


def names(package: Package) -> list[str]:
    return [called[0] for called in package.called]


def test_a_drive_sets_the_watchdog_follows_stops_and_releases_control(package: Package) -> None:
    found = driven(graph("ur10_fast"), driver(), 20, ramp=0.1)
    assert found.stop is None
    assert package.called[0] == ("receive", "arm", 125.0)
    assert package.called[2] == ("setWatchdog", 25.0)  # five periods
    speeds = [called[1:] for called in package.called if called[0] == "speedJ"]
    assert [speed for speed, _, _ in speeds] == [
        [*sent, 0, 0, 0] for sent in np.array(found.journal["sent"][:-1]).tolist()
    ]
    assert {(a, t) for _, a, t in speeds} == {(40.0, 0.008)}
    # a kick in the same cycle would overwrite a speed
    assert "kickWatchdog" not in names(package)
    assert package.called[-4:] == [("speedStop", 2.0), ("stopScript",), ("disconnect",), ("gone",)]


def test_what_the_package_would_send_unseen_is_refused(package: Package) -> None:
    at = driver()
    at.connect()
    at.begin()
    for wrong in (np.array([0.0, np.nan, 0.0]), np.zeros(6), np.full(3, np.inf)):
        with pytest.raises(DriveError, match="ur_rtde:arm: expected 3 finite speeds, found"):
            at.command(wrong)
    assert "speedJ" not in names(package)


def test_values_of_two_samples_are_never_taken_for_one(package: Package) -> None:
    at = driver()
    at.connect()
    package.torn = True
    found = at.read()
    assert (found.time, found.dq[0]) == (package.values["timestamp"], 9.0)


def test_a_robot_that_is_silent_gone_or_takes_nothing_is_lost(package: Package) -> None:
    at = driver()
    at.connect()
    package.silent = True
    with pytest.raises(LostError, match="no sample for 40 ms"):
        at.read()
    package.silent = False
    at.begin()
    package.takes = False
    with pytest.raises(LostError, match="its script does not accept speeds any more"):
        at.command(np.zeros(3))

    def refused(*given: Any) -> Any:
        raise RuntimeError("connect: Connection refused\n")

    sys.modules["rtde_receive"].RTDEReceiveInterface = refused  # type: ignore[attr-defined]
    with pytest.raises(LostError, match="ur_rtde:arm: connect: Connection refused"):
        driver().connect()


def test_another_period_and_a_held_joint_elsewhere_are_refused_and_a_way_is_gone(package: Package) -> None:
    package.step = 0.01
    with pytest.raises(DriveError, match="expected samples 8 ms apart, the graph's clock, found 10 ms"):
        driver().connect()
    package.step = 0.008
    package.values["actual_q"] = [0.0] * 6
    at = driver()
    at.connect()
    with pytest.raises(DriveError, match="expected wrist_2_joint at"):
        at.begin()
    assert "control" not in names(package)
    at.move(np.array([1.0, -1.0, 1.0]), 0.25, 1.0, lambda _: False)
    assert package.called[-1] == ("moveJ", pytest.approx([1, -1, 1, 0, -np.pi / 2, 0]), 0.25, 1.0, True)
    at.begin()


def test_a_way_that_is_ended_is_stopped_as_a_way(package: Package) -> None:
    at = driver()
    package.values["target_q"] = package.values["actual_q"] = [0.0] * 6
    at.connect()
    at.move(np.array([1.0, -1.0, 1.0]), 0.25, 1.0, lambda _: True)
    at.stop(3.0)
    assert package.called[-3:] == [("isProgramRunning",), ("stopJ", 3.0), ("stopScript",)]


def test_without_the_package_one_line_states_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rtde_receive", None)
    with pytest.raises(MissingError, match="expected the package ur_rtde, found none: python -m pip install ur_rtde"):
        driver().connect()


def client(host: str, first: str = "") -> list[str]:
    """A process that drives through the package; only the arm's watchdog depends on real time."""
    Path("arm.yaml").write_text("dmframe-limits: 1\nacceleration: 15 rad/s^2\nlost: 1000\n")
    words = ["drive", "ur10_fast", "--robot", f"ur_rtde:{host}", "--limits", "arm.yaml", "--out", "log", "--no-plots"]
    words += ["--without-a-passed-rehearsal", "--patience", "20 s", "--seconds"]
    return [sys.executable, "-c", f"{first}\nfrom dmframe.cli import main; import sys; sys.argv[1:1] = {words}; main()"]


SLOW = "from dmframe.runtime import ur_rtde; ur_rtde.PATIENCE = 100"
"""A delayed watchdog, as on this machine."""
NONE = "import rtde_control; rtde_control.RTDEControlInterface.setWatchdog = lambda *_: True"


@needs_ur_rtde
def test_the_package_itself_drives_the_virtual_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with robot(series="cb3") as held:
        host = own_host()
        held.listen(host)
        with held.in_background():
            done = subprocess.run(
                [*client(host, SLOW), "1.5 s"], capture_output=True, text=True, timeout=LIMIT, check=False
            )
    assert done.returncode == 0, (done.stdout, done.stderr, list(held.messages)[-20:])
    assert held.safety.ready
    assert not held.running
    assert held.target.still
    replayed = dm.load("ur10_fast").replay("log")
    assert replayed.identical


@needs_ur_rtde
@pytest.mark.parametrize("watched", [True, False])
def test_when_its_process_is_killed_only_the_watchdog_stops_the_arm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, watched: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    with robot(series="cb3") as held:
        trace, host = Trace(held), own_host()
        held.listen(host)
        with subprocess.Popen([*client(host, SLOW if watched else NONE), "20 s"], stdout=subprocess.DEVNULL) as process:
            held.serve(lambda: process.poll() is None and not (held.running and trace.speed[-1:] > [0.2]))
            assert process.poll() is None, list(held.messages)
            process.kill()
        killed = held.time
        held.advance(200)  # 1.6 s
        if watched:
            assert trace.rest(killed) < 1.2  # 0.8 s of its timeout
            assert any(
                "watchdog: input_int_register_0 was not written for 100 cycles" in text for text in held.messages
            )
        else:
            assert trace.speed[-1] > 0.2
            assert held.running
