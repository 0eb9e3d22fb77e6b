"""The driver for Universal Robots arms, byte by byte with a test double that follows the manufacturer's guide."""

from __future__ import annotations

import struct
from functools import cache
from typing import Any

import numpy as np
import pytest
from drivers import driven

import dmframe as dm
from dmframe.common.errors import DriveError, LostError, ValueFault
from dmframe.drive.robots import Options, kind_of
from dmframe.runtime import ur
from dmframe.runtime.rtde import PORT, Rtde
from dmframe.runtime.ur import INPUTS, OUTPUTS, UniversalRobot

KINDS = {"timestamp": "DOUBLE", "speed_scaling": "DOUBLE", "target_speed_fraction": "DOUBLE"}
KINDS |= dict.fromkeys(("actual_q", "actual_qd", "target_q"), "VECTOR6D")
KINDS |= dict.fromkeys(("robot_mode", "safety_mode", "output_int_register_24"), "INT32")
KINDS |= {"runtime_state": "UINT32"}
KINDS |= {name: "DOUBLE" if "double" in name else "INT32" for name in INPUTS}
Q = np.array([1.455411, -1.016031, 0.978316, 0.0, -np.pi / 2, 0.0])


class Arm:
    """Executes commands, with a clock that advances by a sample when one is awaited."""

    def __init__(self) -> None:
        self.values: dict[str, Any] = {
            "timestamp": 100.0,
            "actual_q": Q.copy(),
            "actual_qd": np.zeros(6),
            "target_q": Q.copy(),
            "speed_scaling": 1.0,
            "target_speed_fraction": 1.0,
            "robot_mode": 7,
            "safety_mode": 1,
            "runtime_state": 1,
            "output_int_register_24": 0,
        }
        self.scripts, self.written, self.silent = list[str](), list[tuple[Any, ...]](), False
        self.pending, self.started, self.closed = b"", False, 0
        self.answers: dict[str, bytes] = {}

    def linked(self, host: str, port: int) -> Any:
        assert host == "arm"
        return Main(self) if port == PORT else Scripts(self)

    def tick(self) -> None:
        self.values["timestamp"] += 0.008
        if self.written and self.values["runtime_state"] == 2:
            beat, follow, *dq, _ = self.written[-1]
            self.values["output_int_register_24"] = beat
            self.values["runtime_state"] = 2 if follow else 1
            speed = np.array(dq) * follow
            self.values["actual_qd"] = speed
            for name in ("actual_q", "target_q"):
                self.values[name] = self.values[name] + 0.008 * speed
        body = b"\x01"
        for name in OUTPUTS:
            kind, value = KINDS[name], self.values[name]
            form = {"DOUBLE": ">d", "VECTOR6D": ">6d", "INT32": ">i", "UINT32": ">I"}[kind]
            body += struct.pack(form, *value) if kind == "VECTOR6D" else struct.pack(form, value)
        self.pending += message("U", body)


def message(kind: str, payload: bytes) -> bytes:
    return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload


class Main:
    """The port of RTDE."""

    def __init__(self, arm: Arm) -> None:
        self.arm = arm

    def send(self, data: bytes) -> None:
        length, kind = struct.unpack(">HB", data[:3])
        assert length == len(data)
        payload, answer = data[3:], b"\x01"
        match chr(kind):
            case "V":
                assert payload == b"\x00\x02"
            case "O":
                assert struct.unpack(">d", payload[:8]) == (125.0,)
                answer += ",".join(KINDS[name] for name in payload[8:].decode().split(",")).encode()
            case "I":
                answer = b"\x07" + ",".join(KINDS[name] for name in payload.decode().split(",")).encode()
            case "U":
                assert payload[0] == 7
                self.arm.written.append(struct.unpack(">ii7d", payload[1:]))
                return
        self.arm.pending += message("M", b"a text in between") + message(
            chr(kind), self.arm.answers.get(chr(kind), answer)
        )
        self.arm.started |= chr(kind) == "S"

    def receive(self, patience: float) -> bytes:
        if self.arm.started and patience > 0 and not self.arm.silent and not self.arm.pending:
            self.arm.tick()
        data, self.arm.pending = self.arm.pending, b""
        return data

    def close(self) -> None:
        self.arm.closed += 1


class Scripts:
    """The port that takes scripts; each runs at once."""

    def __init__(self, arm: Arm) -> None:
        self.arm = arm

    def send(self, data: bytes) -> None:
        script = data.decode()
        self.arm.scripts.append(script)
        if "movej" in script:
            goal = np.array([float(word) for word in script.partition("[")[2].partition("]")[0].split(",")])
            self.arm.values["target_q"] = self.arm.values["actual_q"] = goal
        self.arm.values["runtime_state"] = 2 if "dmframe_follow" in script else 1

    def close(self) -> None:
        pass


@cache
def fast() -> dm.Graph:
    return dm.load("ur10_fast")


def driver(arm: Arm) -> UniversalRobot:
    graph = fast()
    made = kind_of("ur:arm")[0].make("arm", graph, Options(1.0))
    assert isinstance(made, UniversalRobot)
    made._linked = arm.linked
    return made


def test_a_drive_follows_stops_and_releases_control() -> None:
    arm, graph = Arm(), fast()
    found = driven(graph, driver(arm), 50, ramp=0.1)
    assert found.stop is None
    assert [script.split("(")[0] for script in arm.scripts] == ["def dmframe_follow"]
    beats = [row[0] for row in arm.written]
    assert beats == list(range(1, 1 + len(beats)))  # none that could be an echo of an earlier output
    assert arm.written[-1][1:] == (0, 0, 0, 0, 0, 0, 0, 2.0)  # end at rest, with this deceleration
    np.testing.assert_array_equal([row[2:5] for row in arm.written[2:-1]], found.journal["sent"][:-1])
    assert all(row[5:8] == (0, 0, 0) for row in arm.written)  # the joints that the graph fixes
    assert arm.values["runtime_state"] == 1
    assert arm.closed == 1
    x = found.journal["x"]
    np.testing.assert_allclose(x[0], [-0.07, 0.82, 0.55], atol=1e-5)
    assert np.isfinite(found.journal["age"][1:]).all()


def test_the_slider_and_what_the_trajectory_limiter_does_are_multiplied() -> None:
    arm = Arm()
    arm.values |= {"speed_scaling": 0.8, "target_speed_fraction": 0.5}
    robot = driver(arm)
    robot.connect()
    assert robot.read().scaling == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"safety_mode": 3}, "robot: protective stop"),
        ({"safety_mode": 7}, "robot: emergency stop of the robot"),
        ({"robot_mode": 5}, "robot: it is not ready to move"),
        ({"runtime_state": 1}, "robot: its script has ended"),
    ],
)
def test_what_the_arm_reports_is_named(changed: dict[str, Any], message: str) -> None:
    arm, graph = Arm(), fast()
    calls = []

    def after() -> str:
        calls.append(1)
        if len(calls) == 10:
            arm.values |= changed
        return ""

    found = driven(graph, driver(arm), 50, ramp=0.1, stop_requested=after)
    assert str(found.stop) == message


def test_a_silent_arm_is_lost_and_a_stop_is_sent_by_the_other_port() -> None:
    arm, graph = Arm(), fast()
    calls = []

    def after() -> str:
        calls.append(1)
        arm.silent = len(calls) >= 10
        return ""

    found = driven(graph, driver(arm), 50, ramp=0.1, stop_requested=after)
    assert str(found.stop) == "lost link: no sample for 40 ms"
    assert arm.scripts[-1] == "def dmframe_stop():\n  stopj(20.0)\nend\n"
    assert arm.closed == 1


def test_it_is_moved_with_the_held_joints_where_the_graph_has_them() -> None:
    arm, graph = Arm(), fast()
    arm.values["actual_q"] = arm.values["target_q"] = Q + 0.1
    found = driven(graph, driver(arm), 3, ramp=0.1, start=Q[:3])
    assert found.stop is None
    assert arm.scripts[0].startswith(
        "def dmframe_move():\n  movej([1.455411000, -1.016031000, 0.978316000, 0.000000000, -1.57"
    )
    arm = Arm()
    arm.values["actual_q"][4] = 0.0
    with pytest.raises(
        DriveError, match=r"expected wrist_2_joint at -1.571 rad, where the graph holds it, found it at 0 rad"
    ):
        driven(graph, driver(arm), 3)
    assert not any(any(row[2:]) for row in arm.written)


def test_an_arm_that_is_not_admitted_gets_no_script_and_one_on_its_way_is_stopped_at_once() -> None:
    arm, graph = Arm(), fast()
    arm.values["safety_mode"] = 3
    assert str(driven(graph, driver(arm), 3).stop) == "robot: protective stop"
    assert arm.scripts == []
    arm = Arm()
    arm.values["runtime_state"] = 2
    robot = driver(arm)
    robot.connect()
    robot._upload("def dmframe_move():\n  movej([0, 0, 0, 0, 0, 0])\nend\n")
    robot.stop(3.0)
    assert arm.scripts[-1] == "def dmframe_stop():\n  stopj(3.0)\nend\n"
    assert arm.written == []


def test_samples_that_wait_are_skipped_for_the_newest_and_counted() -> None:
    arm = Arm()
    robot = driver(arm)
    robot.connect()
    assert robot.read().missed == 0
    for _ in range(4):
        arm.tick()
    found = robot.read()
    assert (found.missed, found.time) == (3, pytest.approx(100.0 + 7 * 0.008))


def test_an_unknown_name_another_version_and_no_answer_are_reported() -> None:
    for kind, answer, message in (
        ("V", b"\x00", "expected version 2 of the protocol"),
        ("O", b"\x01" + b"NOT_FOUND," * (len(OUTPUTS) - 1) + b"DOUBLE", "found timestamp: NOT_FOUND"),
        (
            "I",
            b"\x00" + b"IN_USE," * (len(INPUTS) - 1) + b"DOUBLE",
            "writes input_int_register_24 and 7 more",
        ),
        ("S", b"\x00", "the robot does not start to send samples"),
    ):
        arm = Arm()
        arm.answers[kind] = answer
        with pytest.raises(DriveError, match=message):
            driver(arm).connect()

    class Mute(Main):
        def receive(self, patience: float) -> bytes:
            return b""

    with pytest.raises(LostError, match="RTDE: no answer for 2 s"):
        Rtde(Mute(Arm()), 125.0, OUTPUTS, INPUTS)


def test_the_script_uses_registers_that_no_fieldbus_has_and_stops_in_the_thread_that_moves() -> None:
    registers = [int(part.split(")")[0].split(",")[0]) for part in ur.FOLLOW.split("register(")[1:]]
    assert min(registers) >= 24
    mover = ur.FOLLOW[ur.FOLLOW.index("thread dm_move") : ur.FOLLOW.index("  dm_beat =")]
    assert ur.FOLLOW.count("stopj(") == mover.count("stopj(") == 1
    assert "dm_most = 0.036" in driver(Arm())._script  # passed in the fifth period of silence


def test_addresses_and_arms_are_checked() -> None:
    panda = dm.load("panda_full")
    with pytest.raises(ValueFault, match="expected the address of an arm"):
        kind_of("ur")[0].make("", panda, Options(1.0))
    with pytest.raises(DriveError, match="expected the joints of a UR in their order, found panda_joint1"):
        kind_of("ur:x")[0].make("x", panda, Options(1.0))


@pytest.mark.parametrize("kind", ["M", "U"])
def test_what_comes_without_a_sample_is_not_read_for_ever(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr("dmframe.runtime.rtde.time.monotonic", lambda: clock[0])

    class Babbling(Main):
        def receive(self, patience: float) -> bytes:
            if not self.arm.silent:
                return super().receive(patience)
            clock[0] += 0.001
            return message(kind, b"another payload than was agreed")

    arm = Arm()
    held = Rtde(Babbling(arm), 125.0, OUTPUTS, INPUTS)
    arm.silent = True
    with pytest.raises(LostError, match="no sample for 40 ms"):
        held.read(0.04)
    with pytest.raises(LostError, match="RTDE: no answer for 2 s"):
        Rtde(Babbling(arm), 125.0, OUTPUTS, INPUTS)
    assert clock[0] < 3


@pytest.mark.parametrize("kind", ["O", "I"])
def test_another_type_and_too_few_of_them_are_reported(kind: str) -> None:
    names = OUTPUTS if kind == "O" else INPUTS
    for kinds, message in (
        ([*["DOUBLE"] * 2, *list(names.values())[2:]], "types of the maker's guide, found "),
        (["DOUBLE"], f"expected an answer for {len(names)} names, found 1"),
    ):
        arm = Arm()
        arm.answers[kind] = b"\x01" + ",".join(kinds).encode()
        with pytest.raises(DriveError, match=message):
            driver(arm).connect()
    arm = Arm()
    arm.answers[kind] = b""
    with pytest.raises(DriveError, match="found 1"):
        driver(arm).connect()


def test_samples_out_of_order_count_none_as_lost_that_came() -> None:
    robot = driver(Arm())
    robot.connect()
    message = robot._newest(1.0)
    missed = []
    for tick in (0, 2, 1, 3, 4):
        at = {**message, "timestamp": 200 + 0.008 * tick}
        missed.append(robot._sample(at).missed)
    assert missed == [0, 1, 0, 0, 0]


def test_on_its_way_it_ends_where_what_watches_reports_it() -> None:
    arm, seen = Arm(), list[Any]()
    arm.values["target_q"] = arm.values["actual_q"] = Q + 0.1
    at = driver(arm)
    at.connect()
    monitored = at._upload

    def upload(script: str) -> None:  # an arm that does not move
        held = arm.values["target_q"], arm.values["actual_q"]
        monitored(script)
        arm.values["target_q"], arm.values["actual_q"] = held

    at._upload = upload  # type: ignore[method-assign]
    at.move(Q[:3], 0.25, 1.0, lambda sample: seen.append(sample) or len(seen) == 4)  # type: ignore[func-returns-value]
    assert len(seen) == 4
    np.testing.assert_allclose(seen[0].q, Q[:3] + 0.1)
    at.stop(3.0)
    assert arm.scripts[-1] == "def dmframe_stop():\n  stopj(3.0)\nend\n"
