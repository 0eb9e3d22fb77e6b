"""`ur:HOST` drives the virtual robot, whose clock waits for it: its motion, and its end after each fault."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from drivers import driven, limits
from virtual_robots import Line, Trace, graph, robot

from dmframe.common.errors import DriveError
from dmframe.drive.robots import Options, kind_of
from dmframe.runtime.driving import DriveResult
from dmframe.runtime.gate import Gate
from dmframe.runtime.scaled import ScaledController
from dmframe.runtime.ur import UniversalRobot
from dmframe.virtual import VirtualRobot

pytestmark = pytest.mark.usefixtures("without_v")

SOON = 0.1
"""Time within which an arm stops after a fault [s]."""
FAST = 180
"""The sample near the largest joint speed of `ur10_fast`, 0.335 rad/s."""


@dataclass
class Setting:
    """A robot, its connection, and its driver."""

    held: VirtualRobot
    line: Line
    driver: UniversalRobot
    trace: Trace


def setting(name: str = "ur10_fast", series: str = "cb3", **behaviour: Any) -> Setting:
    held = robot(series=series, **behaviour)
    line = Line(held)
    return Setting(held, line, driver(line, name), Trace(held))


def driver(line: Line, name: str = "ur10_fast", **changed: Any) -> UniversalRobot:
    own = graph(name) if not changed else graph(name).set(changed)
    made = kind_of("ur:arm")[0].make("arm", own, Options(1.0))
    assert isinstance(made, UniversalRobot)
    made._linked = line
    return made


def drive(
    at: Setting, happens: Callable[[Setting], str | None] = lambda _: None, tick: int = FAST, ticks: int = 250
) -> tuple[DriveResult, float]:
    """Drive; at a sample an action is executed. Returns how the drive ended, and when by the robot's clock."""
    count, when = [0], [0.0]

    def stop_requested() -> str:
        count[0] += 1
        if count[0] != tick:
            return ""
        when[0] = at.held.time
        return happens(at) or ""

    held = limits(graph("ur10_fast"), acceleration=np.full(3, 40.0))
    found = driven(graph("ur10_fast"), at.driver, ticks, engine="auto", held=held, stop_requested=stop_requested)
    at.held.advance(30)
    return found, when[0]


def x_of(found: DriveResult) -> np.ndarray:
    return found.journal["x"]


def test_at_125_samples_a_second_it_is_the_run_and_no_sample_is_lost_or_used_twice() -> None:
    run = graph("ur10_fast").run(2.0, progress=False).recording
    at = setting()
    found, _ = drive(at)
    assert found.stop is None
    x = x_of(found)
    assert len(x) == len(run["arm.x"]) == 251
    assert np.max(np.abs(x - run["arm.x"])) < 1e-9  # 0.1 mm is required
    np.testing.assert_allclose(np.diff(found.journal["time"]), 0.008, rtol=1e-9)
    assert not found.journal["missed"].any()
    assert at.held.messages[-1].endswith("dmframe_follow ends: its last line is done")


def test_a_sample_of_delay_would_be_noticed() -> None:
    run = graph("ur10_fast").run(2.0, progress=False).recording
    found, _ = drive(setting(command_delay=1))
    assert found.stop is None
    assert np.max(np.abs(x_of(found) - run["arm.x"])) > 1e-3


def test_an_arm_with_a_shorter_cycle_takes_a_command_in_the_one_after_the_sample() -> None:
    run = graph("ur10_fast").run(2.0, progress=False).recording
    at = setting(series="e")
    found, _ = drive(at)
    assert found.stop is None
    assert not found.journal["missed"].any()
    assert 1e-5 < np.max(np.abs(x_of(found) - run["arm.x"])) < 3e-4


def cut(at: Setting) -> None:
    at.line.cut = True


def close(at: Setting) -> None:
    at.line.closed = True


def press(at: Setting) -> None:
    at.held.emergency_stop()


def protect(at: Setting) -> None:
    at.held.protective_stop()


def lose(at: Setting) -> None:
    at.held.lose(20)


def power_off(at: Setting) -> None:
    at.held.power_off()


FAULTS: dict[str, tuple[Callable[[Setting], None], str, str]] = {
    "cut": (cut, "lost link: no sample for 40 ms", "dmframe_follow ends: its last line is done"),
    "closed": (
        close,
        "lost link: lost link: the robot has closed the connection; the stop command was not sent: the robot has "
        "closed the connection",
        "dmframe_follow ends: its last line is done",
    ),
    "samples": (lose, "lost link: no sample for 40 ms", "dmframe_follow ends: "),
    "emergency": (press, "robot: emergency stop of the robot", "ends: emergency stop: the button is pressed"),
    "protective": (protect, "robot: protective stop", "ends: protective stop: requested"),
    "power": (power_off, "robot: its script has ended", "ends: the power is off"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_after_a_fault_the_arm_soon_rests_and_both_sides_name_the_reason(name: str) -> None:
    happens, ours, theirs = FAULTS[name]
    at = setting()
    found, when = drive(at, happens)
    assert max(at.trace.speed) > 0.33
    assert str(found.stop) == ours
    assert any(theirs in text for text in at.held.messages)
    assert at.trace.rest(when) < SOON
    assert len(found.journal["sent"]) >= FAST - 1  # the samples until then are stored


def never_silent(at: Setting) -> None:
    at.driver._script = at.driver._script.replace("dm_most = 0.036", "dm_most = 1000")


def test_without_a_heartbeat_an_arm_whose_link_is_cut_would_go_on() -> None:
    at = setting()
    never_silent(at)
    found, when = drive(at, cut)
    assert str(found.stop) == "lost link: no sample for 40 ms"
    assert at.trace.rest(when) == np.inf
    assert at.trace.speed[-1] > 0.3


def test_a_gentle_halt_would_not_be_soon_enough() -> None:
    at = setting()
    at.driver._script = at.driver._script.replace("dm_halt = 20.0", "dm_halt = 2.0")
    _, when = drive(at, cut)
    assert SOON < at.trace.rest(when) < np.inf


@pytest.mark.parametrize("where", ["command", "sample"])
def test_what_is_not_a_number_is_not_sent_and_the_arm_soon_rests(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(at: Setting) -> None:
        if where == "command":
            spoilt(monkeypatch)
        else:
            at.driver._arm.tool = lambda q: np.full(3, np.nan)

    at = setting()
    found, when = drive(at, broken)
    message = "command not finite: [nan" if where == "command" else "not finite: invalid sample: x = [nan"
    assert str(found.stop).startswith(message)
    assert at.held.safety.ready  # the robot did not receive it
    assert at.trace.rest(when) < SOON


def spoilt(monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on the controller outputs NaN."""
    step = ScaledController.step

    def nan(self: ScaledController, *given: Any) -> bool:
        step(self, *given)
        self.command[0] = np.nan
        return True

    monkeypatch.setattr(ScaledController, "step", nan)


def test_without_the_gate_it_would_be_sent_and_the_robot_stops_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    def through(self: Gate, command: np.ndarray, out: np.ndarray, missed: int = 0) -> None:
        out[:] = command

    monkeypatch.setattr(Gate, "limited", through)
    at = setting()
    found, _ = drive(at, lambda _: spoilt(monkeypatch))
    assert str(found.stop) == "robot: protective stop"
    assert at.held.safety.reason == "protective stop: a target speed is not a number"


def test_a_stop_that_is_requested_is_as_gentle_as_the_limits_require() -> None:
    at = setting()
    found, when = drive(at, lambda _: "SIGTERM")
    assert str(found.stop) == "requested: SIGTERM"
    slowed = -np.diff(at.trace.commanded) / at.held.dt
    assert np.max(slowed) == pytest.approx(2.0)  # not the 40 rad/s^2 with which it tracks
    assert at.trace.rest(when) == pytest.approx(0.335 / 2, abs=0.03)


def test_what_a_killed_client_has_left_in_registers_moves_nothing() -> None:
    at = setting()
    drive(at, cut)
    assert at.held.registers.values["input_double_register_26"] != 0
    begun = len(at.trace.commanded)
    at.held.load_script(at.driver._script)
    at.held.advance(200)
    assert max(at.trace.commanded[begun:]) == 0
    assert not at.held.running  # no heartbeat for a second
    at.held.load_script(at.driver._script.replace("dm_started = False", "dm_started = True"))
    at.held.advance(20)
    assert max(at.trace.commanded[begun:]) > 0.1
    at.line.cut = False
    at.driver = driver(at.line)
    again, _ = drive(at, tick=0, ticks=20)  # from the motion to the start on
    assert again.stop is None


def test_lost_samples_are_counted_and_the_clock_is_the_robots() -> None:
    run = graph("ur10_fast").run(2.0, progress=False).recording
    at = setting(lost=0.05, seed=3)
    found, _ = drive(at)
    assert found.stop is None
    missed = int(found.journal["missed"].sum())
    lost = 251 - len(found.journal)
    assert missed == lost > 5
    taken = np.round(found.journal["time"] / 0.008).astype(int)
    assert taken[-1] == 250
    assert np.max(np.abs(x_of(found) - run["arm.x"][taken])) < 5e-3  # some commands were held for two samples


def test_a_speed_slider_keeps_the_path() -> None:
    at = setting()

    def slow(at: Setting) -> None:
        at.held.slider = 0.5

    found, _ = drive(at, slow, tick=50)
    assert found.stop is None
    assert found.journal["time"][-1] == pytest.approx(50 * 0.008 + 2 * 200 * 0.008, abs=0.03)
    x, t = x_of(found), found.journal["reference"]
    around = np.stack([-0.07 + 0.15 * np.sin(t), 0.67 + 0.15 * np.cos(t)], axis=1)
    ideal, _ = drive(setting())
    at_full = np.stack([np.interp(t, ideal.journal["reference"], x_of(ideal)[:, k]) for k in range(2)], axis=1)
    apart = np.linalg.norm(x[:, :2] - around, axis=1).max()
    assert apart < np.linalg.norm(at_full - around, axis=1).max() + 2e-3


def test_a_second_client_is_refused_and_the_first_goes_on() -> None:
    at = setting()

    def another(at: Setting) -> None:
        with pytest.raises(DriveError, match="writes input_int_register_24 and 8 more of the registers"):
            driven(graph("ur10_fast"), driver(at.line), 5, engine="auto")
        assert len(at.line.others) == 1  # it has stopped the control

    found, _ = drive(at, another)
    alone, _ = drive(setting())
    assert found.stop is None
    assert np.array_equal(found.journal["sent"], alone.journal["sent"])


@pytest.mark.parametrize(
    ("before", "message"),
    [
        (power_off, "robot: it is not ready to move"),
        (press, "robot: emergency stop of the robot"),
        (protect, "robot: protective stop"),
    ],
)
def test_a_robot_that_is_not_ready_gets_no_script(before: Callable[[Setting], None], message: str) -> None:
    at = setting()
    before(at)
    found, _ = drive(at)
    assert str(found.stop) == message
    assert not any("dmframe" in text for text in at.held.messages)
    assert max(at.trace.commanded) == 0


def test_a_graph_with_more_joints_than_the_arm_lets_move_is_stopped_by_the_arm() -> None:
    at = setting("ur10_full")
    own = graph("ur10_full")
    found = driven(own, at.driver, 50, held=limits(own, acceleration=np.full(6, 40.0)))
    assert str(found.stop) == "robot: protective stop"
    assert at.held.safety.reason.endswith("is commanded to move, but the graph holds it")


def test_a_graph_that_holds_joints_elsewhere_is_refused_before_it_moves() -> None:
    at = setting()
    at.driver = driver(at.line, **{"robot.hold": {}})  # which is 0 for each of them
    with pytest.raises(DriveError, match="expected wrist_2_joint at 0 rad, where the graph holds it, found"):
        drive(at)
    assert max(at.trace.commanded) == 0


def test_an_arm_whose_cycle_does_not_divide_the_graphs_clock_is_refused() -> None:
    at = setting()
    wrong = graph("ur10_fast").set({"clock": "10 ms"})
    at.driver = driver(at.line, clock="10 ms")
    with pytest.raises(DriveError, match="ur:arm: expected samples 10 ms apart, the graph's clock, found 8 ms"):
        driven(wrong, at.driver, 5)
    assert at.line.others == []  # and stopped the control
    finer = setting(series="e")
    finer.driver = driver(finer.line, clock="10 ms")
    assert driven(wrong, finer.driver, 20).stop is None


def test_the_way_to_the_start_is_gone_before_the_first_command() -> None:
    at = setting()
    at.held.load_script("def away():\n  speedj([0.2, 0.1, 0, 0, 0, 0], 2, 0.5)\n  stopj(2)\nend\n")
    at.held.advance(200)
    start = np.array([1.455411, -1.016031, 0.978316])
    assert np.abs(at.held.q[:3] - start).max() > 0.05
    held = limits(graph("ur10_fast"), acceleration=np.full(3, 40.0))
    found = driven(graph("ur10_fast"), at.driver, 20, engine="auto", held=held, start=start)
    assert found.stop is None
    assert np.abs(found.journal["q_c"][0] - start).max() < 1e-8
    assert np.abs(found.journal["q"][0] - start).max() < 5e-3  # its servo settles slowly
