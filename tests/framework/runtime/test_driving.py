"""The real-time loop: start and end of a drive, and the calls of the driver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from drivers import Script, driven, limits, simulated

import dmframe as dm
from dmframe.common.errors import DriveError, LostError
from dmframe.runtime.driving import DriveResult
from dmframe.runtime.robot import Sample

Q = np.array([1.455411, -1.016031, 0.978316])
X = np.array([0.08, 0.67, 0.55])


@cache
def graph() -> dm.Graph:
    return dm.load("ur10_fast")


def standing(ticks: int, **changed: Any) -> list[Any]:
    """Samples of a robot that does not move."""
    return [replace(Sample(0.008 * k, Q, np.zeros(3), Q, X), **changed) for k in range(ticks)]


def ended(samples: list[Any], ticks: int = 20, **plan: Any) -> tuple[DriveResult, Script]:
    robot = Script(samples)
    return driven(graph(), robot, ticks, **plan), robot


def test_at_its_end_the_robot_is_stopped_and_let_go() -> None:
    found, robot = ended(standing(21))
    assert found.stop is None
    assert robot.calls[0] == "connect"
    assert robot.calls[-2:] == [("stop", 2.0), "close"]
    assert len(robot.calls) == 20 + 3  # a command a period
    np.testing.assert_array_equal(robot.calls[1:-2], found.journal["sent"][:-1])


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (LostError("no sample for 40 ms"), "lost link: no sample for 40 ms"),
        (KeyboardInterrupt(), "requested: Ctrl-C"),
        (standing(1, time=0.04, dq=np.full(3, np.nan))[0], "not finite: invalid sample: dq = [nan, nan, nan]"),
        (standing(1, time=0.04, fault="protective stop")[0], "robot: protective stop"),
        (standing(1, time=0.04, ready=False)[0], "robot: it is not ready to move"),
        (standing(1, time=0.04, missed=9)[0], "lost samples: 9 in a row, at most 5 are allowed"),
        (standing(1, time=0.04, dq=np.full(3, 1e308))[0], "controller: a command or a state is not finite"),
    ],
)
def test_each_fault_is_named_and_the_robot_is_stopped(fault: Any, message: str) -> None:
    found, robot = ended([*standing(5), fault, *standing(20)])
    assert str(found.stop) == message
    assert robot.calls[-2:] == [("stop", 2.0 if message.startswith("requested") else 20.0), "close"]
    assert len(found.journal["sent"]) == 5
    assert all(np.isfinite(command).all() for command in robot.calls[1:-2])


def test_a_stop_that_cannot_be_sent_is_reported_with_the_first_reason() -> None:
    class Gone(Script):
        def stop(self, deceleration: float) -> None:
            raise LostError("the connection is closed")

    robot = Gone([*standing(5), LostError("no sample for 40 ms")])
    found = driven(graph(), robot, 20)
    assert str(found.stop) == (
        "lost link: lost link: no sample for 40 ms; the stop command was not sent: the connection is closed"
    )
    assert robot.calls[-1] == "close"


def test_a_defect_stops_the_robot_too() -> None:
    robot = Script(standing(5))
    with pytest.raises(IndexError):  # of the list of samples
        driven(graph(), robot, 20)
    assert robot.calls[-2:] == [("stop", 20.0), "close"]


def test_it_stops_at_the_next_sample_after_a_request() -> None:
    calls = []

    def stop_requested() -> str:
        calls.append(1)
        return "SIGTERM" if len(calls) > 7 else ""

    found, robot = ended(standing(21), stop_requested=stop_requested)
    assert str(found.stop) == "requested: SIGTERM"
    assert len(robot.calls) == 7 + 3


def test_a_stopped_clock_is_read_again_and_then_lost() -> None:
    samples = standing(21)
    found, robot = ended([*samples[:4], *[samples[3]] * 3, *samples[4:]])
    assert found.stop is None
    assert len(robot.calls) == 20 + 3  # no sample was used twice
    found, _ = ended([*samples[:4], *[samples[3]] * 9])
    assert str(found.stop) == "lost samples: the robot's clock does not advance beyond 0.024 s"


def test_in_shadow_nothing_is_sent_and_the_commands_are_the_same() -> None:
    plain, _ = ended(standing(21))
    found, robot = ended(standing(21), shadow=True)
    assert robot.calls == ["connect", "close"]
    np.testing.assert_array_equal(found.journal["command"], plain.journal["command"])


def test_it_is_moved_to_the_start_first_and_the_controller_begins_there() -> None:
    away = Q + np.array([0.1, 0, 0])
    found, robot = ended([Sample(0.0, away, np.zeros(3), away, X), *standing(21)], start=Q)
    assert robot.calls[1] == ("move", Q.tolist())
    assert found.stop is None
    np.testing.assert_array_equal(found.journal["state:inverse.q_r"][0], Q)
    found, robot = ended([Sample(0.0, away, np.zeros(3), away, X)], start=Q, shadow=True)
    assert (found.stop is not None and found.stop.rule) == "start"
    assert robot.calls == ["connect", "close"]


def test_a_robot_at_another_pose_moves_to_the_start_and_then_runs_as_usual() -> None:
    q = (Q + 0.05).tolist()
    robot = simulated(graph(), start={"arm.q": q, "servo.q_c": q})
    found = driven(graph(), robot, 60, start=Q)
    assert found.stop is None
    assert found.journal["time"][0] == found.journal["reference"][0] == 0
    np.testing.assert_allclose(found.journal["q"][0], Q, atol=5e-3)  # friction holds its servo slightly off
    run = graph().run("0.48 s", engine="interpreted", progress=False).recording
    np.testing.assert_allclose(found.journal["command"], run["inverse.dq_c"], atol=0.01)


def test_a_robot_that_lacks_what_the_controller_needs_is_refused_before_it_moves() -> None:
    for changed, message in (
        ({"x": None}, "script: the controller needs x, which this robot lacks"),
        ({"q": np.zeros(6)}, "script: expected 3 joints as in the graph, found 6"),
    ):
        robot = Script(standing(3, **changed))
        with pytest.raises(DriveError) as raised:
            driven(graph(), robot, 3)
        assert str(raised.value) == message
        assert not any(isinstance(each, np.ndarray) for each in robot.calls)
    slow = Script(standing(3))
    slow.period = 0.002
    with pytest.raises(DriveError, match=r"expected a robot with the graph's clock of 0.008 s, found one with 0.002 s"):
        driven(graph(), slow, 3)


def test_a_ramp_keeps_the_start_below_an_acceleration_that_it_would_else_pass() -> None:
    held = limits(graph(), acceleration=np.full(3, 15.0))
    steep = driven(graph(), simulated(graph()), 40, held=held)
    assert steep.cuts["acceleration"] > 0
    soft = driven(graph(), simulated(graph()), 40, held=held, ramp=0.16)
    assert soft.cuts == {}
    assert soft.journal["scale"][0] == pytest.approx(0.05)
    assert soft.journal["scale"][-1] == 1
    assert soft.journal["reference"][-1] == pytest.approx(40 * 0.008, abs=0.009)
    assert soft.journal["time"][-1] == pytest.approx(40 * 0.008 + 0.08, abs=0.01)  # half of the ramp has passed


class Hidden:
    """A robot that does not report its speed scaling."""

    def __init__(self, robot: Any) -> None:
        self._robot = robot

    def __getattr__(self, name: str) -> Any:
        return getattr(self._robot, name)

    def read(self) -> Sample:
        return replace(self._robot.read(), scaling=1.0)


def missed(found: DriveResult) -> float:
    """Largest distance of the tool from its path, the circle of the graph, in the second half [m]."""
    x = found.journal["x"]
    offset = np.hypot(x[:, 0] + 0.07, x[:, 1] - 0.67) - 0.15
    return float(np.sqrt(np.mean(offset[len(x) // 2 :] ** 2)))


def test_a_slowed_robot_goes_the_same_path_as_much_more_slowly() -> None:
    full = driven(graph(), simulated(graph()), 250)
    half = driven(graph(), simulated(graph(), scaling=0.5), 250)
    assert half.stop is None
    assert half.journal["time"][-1] == pytest.approx(4.0, abs=0.01)
    assert half.journal["reference"][-1] == pytest.approx(2.0, abs=0.01)
    np.testing.assert_allclose(half.journal["x"][-1], full.journal["x"][-1], atol=0.01)
    ignorant = driven(graph(), Hidden(simulated(graph(), scaling=0.5)), 500)
    assert missed(ignorant) > 2 * missed(half)


def test_its_controller_reads_velocities_and_periods_of_its_own_time() -> None:
    moving = [replace(sample, dq=np.full(3, 0.05), scaling=0.5) for sample in standing(3)]
    found, _ = ended(moving, ticks=1)
    controller = graph().controller(engine="interpreted")
    for label, values in (("q", Q), ("dq", np.full(3, 0.1)), ("x", X)):
        controller.measured[f"arm.{label}"][:] = values
    controller.measured["servo.q_c"][:] = Q
    controller.measured["arm.dq"][:] = 0.05
    controller.reset(measured=True)
    controller.measured["arm.dq"][:] = 0.1
    controller.step(0.0, 0.004)
    np.testing.assert_array_equal(found.journal["command"][0], controller.commanded["inverse.dq_c"])
    for label, values in controller.states.items():
        np.testing.assert_array_equal(found.journal[f"state:{label}"][1], values)


def test_a_robot_at_rest_is_waited_for() -> None:
    samples = [replace(sample, scaling=0.0 if 5 <= k < 15 else 1.0) for k, sample in enumerate(standing(40))]
    found, robot = ended(samples)
    assert found.stop is None
    reference = found.journal["reference"]
    assert reference[15] == pytest.approx(reference[5])
    assert not np.any(robot.calls[6:16])
    assert not found.journal["scale"][5:15].any()


class Walker(Script):
    """Moves to its start in ten samples, and stops there on request."""

    def __init__(self, samples: list[Any], way: list[Sample]) -> None:
        super().__init__(samples)
        self.way = way

    def move(self, q: np.ndarray, speed: float, acceleration: float, watched: Callable[[Sample], bool]) -> None:
        for sample in self.way:
            self.calls.append("way")
            if watched(sample):
                return


AWAY = Q + np.array([0.1, 0, 0])


def walked(way: list[Sample], **plan: Any) -> tuple[DriveResult, Walker]:
    robot = Walker([Sample(0.0, AWAY, np.zeros(3), AWAY, X), *standing(21)], way)
    return driven(graph(), robot, 20, start=Q, **plan), robot


def test_a_stop_that_is_requested_before_or_on_the_way_to_the_start_ends_the_way() -> None:
    for after in (0, 3):
        calls = []

        def stop_requested(calls: list[int] = calls, after: int = after) -> str:
            calls.append(1)
            return "Ctrl-C" if len(calls) > after else ""

        found, robot = walked(standing(10), stop_requested=stop_requested)
        assert str(found.stop) == "requested: Ctrl-C"
        assert robot.calls == ["connect", *["way"] * after, ("stop", 2.0), "close"]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"fault": "protective stop"}, "robot: protective stop"),
        (
            {"q_c": Q + np.array([1.0, 0, 0])},
            "deviation: shoulder_pan_joint is 1 rad from its target, at most 200 mrad is allowed",
        ),
        ({"x": X + 9.0}, "workspace: coordinate 1 of the tool is at 9.08 m, its box is -1 m to 1 m"),
        ({"q": np.full(3, np.nan)}, "not finite: invalid sample: q = [nan, nan, nan]"),
    ],
)
def test_the_gate_watches_the_way_to_the_start(changed: dict[str, Any], message: str) -> None:
    held = limits(graph(), box=np.array([[-1.0] * 3, [1.0] * 3]))
    way = [*standing(3), *standing(1, **changed), *standing(6)]
    found, robot = walked(way, held=held)
    assert str(found.stop) == message
    assert robot.calls == ["connect", *["way"] * 4, ("stop", 20.0), "close"]
    found, robot = walked(standing(10, missed=99), held=held)  # the robot moves by its own program
    assert found.stop is None


@pytest.mark.parametrize("start", [Q, None])
def test_a_drive_does_not_begin_beyond_a_limit(start: np.ndarray | None) -> None:
    own = limits(graph())
    held = replace(own, upper=np.array([*own.upper[:2], 0.5]))
    robot = Script(standing(21))
    found = driven(graph(), robot, 20, start=start, held=held)
    assert str(found.stop) == ("joint limit: elbow_joint would start at 978 mrad, its limits are -3.14 rad to 500 mrad")
    assert robot.calls == ["connect", ("stop", 20.0), "close"]


def test_a_clock_that_continues_after_a_stop_has_lost_no_sample() -> None:
    samples = standing(21)
    twice = [sample for sample in samples[:20] for _ in range(2)]
    found, robot = ended([*twice, samples[20]])  # each sample twice
    assert found.stop is None
    assert len(robot.calls) == 20 + 3
    found, _ = ended([*samples[:4], *[samples[3]] * 5, *samples[4:]])  # as often as possible
    assert found.stop is None
