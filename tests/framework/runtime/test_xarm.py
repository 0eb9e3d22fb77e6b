"""The driver for UFACTORY arms with a test double of the manufacturer's package, and its reports.

If the package is installed, the double's calls are compared with its signatures, and the reports with its own reader.
"""

from __future__ import annotations

import inspect
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drivers import driven

import dmframe as dm
from dmframe.common.errors import DriveError, LostError, ValueFault
from dmframe.drive.robots import Options, kind_of
from dmframe.runtime import xarm
from dmframe.runtime.xarm import Report, XArm

GRAPH = """\
dmframe: 1
robot: {model: xarm7, free: [joint1, joint2, joint4], hold: {joint6: 0.8}}
clock: CLOCK
duration: 1 s
start: {q: [0.1, -0.5, 1.0]}
blocks:
  path:     {type: sinusoid, center: [0.1, -0.5, 1.0], amplitude: [0.1, 0.1, 0.1], rate: [0.5, 0.7, 0.9]}
  task:     {type: joint_tracking, alpha_bar: 2}
  model:    {type: regressor, friction: [viscous]}
  dynamics: {type: dynamic_compensator, Gamma: 1}
  inverse:  {type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w_I: 1}
  servo:    {type: pi_servo, K_P: [200, 200, 100], K_I: [400, 400, 200]}
  arm:      {type: manipulator, viscous: [5, 5, 2]}
"""
HELD = np.array([0.1, -0.5, 0.0, 1.0, 0.0, 0.8, 0.0])


@pytest.fixture
def graph(tmp_path: Path) -> dm.Graph:
    return graph_of(tmp_path, "5 ms")


def graph_of(folder: Path, clock: str) -> dm.Graph:
    file = folder / "seven.yaml"
    file.write_text(GRAPH.replace("CLOCK", clock), encoding="utf-8")
    return dm.load(file)


def report(time: float, state: int, mode: int, q_c: Any, q: Any, dq: Any, more: int = 0) -> bytes:
    """In the format of the manufacturer: whole numbers big-endian, others little-endian."""
    size = 784 + more
    head = struct.pack(">IQBH17x", size, round(time * 1e6), state | mode << 4, 0)
    joints = b"".join(struct.pack("<7f", *numbers) for numbers in (q_c, dq, np.zeros(7), q, dq, np.zeros(7)))
    return (head + joints).ljust(size, b"\x00")


class Arm:
    """Executes the calls of the package, with a clock that advances by a report when one is awaited."""

    def __init__(self, port: Any = None, is_radian: bool = False) -> None:
        self.version_number, self.axis, self.error_code = (2, 4, 0), 7, 0
        self.time, self.state, self.mode = 50.0, 2, 0
        self.q, self.dq = HELD.copy(), np.zeros(7)
        self.until = np.inf
        self.calls, self.code, self.silent, self.closed, self.pending = list[Any](), 0, False, 0, b""
        self.goal: np.ndarray | None = None

    def motion_enable(self, enable: bool = True, servo_id: Any = None) -> int:
        self.calls.append(("motion_enable", enable))
        return 0

    def set_mode(self, mode: int = 0, detection_param: int = 0) -> int:
        self.mode = mode
        self.calls.append(("set_mode", mode))
        return 0

    def set_state(self, state: int = 0) -> int:
        self.calls.append(("set_state", state))
        self.state = 2 if state == 0 else state
        if state == 4:
            self.dq = np.zeros(7)
        return 0

    def set_servo_angle(
        self, servo_id: Any = None, angle: Any = None, speed: Any = None, mvacc: Any = None, mvtime: Any = None,
        relative: bool = False, is_radian: Any = None, wait: bool = False, timeout: Any = None, radius: Any = None,
        **kwargs: Any,
    ) -> int:  # fmt: skip
        assert is_radian
        assert not wait
        self.calls.append(("set_servo_angle", angle, speed, mvacc))
        self.goal = np.array(angle)
        return self.code

    def vc_set_joint_velocity(
        self, speeds: Any, is_radian: Any = None, is_sync: bool = True, duration: float = -1, **kwargs: Any
    ) -> int:
        assert is_radian
        assert not is_sync
        self.calls.append(("velocity", list(speeds), duration))
        if self.code == 0:
            self.dq, self.until = np.array(speeds), self.time + duration
        return self.code

    def disconnect(self) -> None:
        self.closed += 1

    def tick(self) -> None:
        self.time += 0.005
        if self.goal is not None and self.mode == 0:
            self.q, self.goal = np.clip(self.goal, self.q - 0.02, self.q + 0.02), self.goal
        if self.time > self.until + 1e-9:
            self.dq = np.zeros(7)
        if self.mode == 4 and self.state == 2:
            self.q = self.q + 0.005 * self.dq
        self.pending += report(self.time, self.state, self.mode, self.q, self.q, self.dq)

    # the test double of the port of reports

    def receive(self, patience: float) -> bytes:
        if patience > 0 and not self.silent and not self.pending:
            self.tick()
        data, self.pending = self.pending, b""
        return data

    def send(self, data: bytes) -> None:
        raise AssertionError("nothing is sent to the port of reports")

    def close(self) -> None:
        self.closed += 1


def driver(graph: dm.Graph, arm: Arm) -> XArm:
    made = kind_of("xarm:arm")[0].make("arm", graph, Options(1.0))
    assert isinstance(made, XArm)
    made._opened, made._linked = lambda _: arm, lambda host, port: arm
    return made


def velocities(arm: Arm) -> list[Any]:
    return [row for row in arm.calls if row[0] == "velocity"]


def test_a_drive_follows_stops_and_releases_control(graph: dm.Graph) -> None:
    arm = Arm()
    found = driven(graph, driver(graph, arm), 100, ramp=0.1)
    assert found.stop is None
    assert arm.calls[:3] == [("motion_enable", True), ("set_mode", 4), ("set_state", 0)]
    assert arm.calls[-1] == ("set_state", 4)
    sent = np.array([row[1] for row in velocities(arm)])
    np.testing.assert_array_equal(sent[:100][:, [0, 1, 3]], found.journal["sent"][:100])
    assert not sent[:, [2, 4, 5, 6]].any()  # the joints that the graph fixes
    assert {row[2] for row in velocities(arm)} == {0.025}  # it stops by itself
    assert np.max(np.abs(np.diff(sent[100:], axis=0))) <= 2.0 * 0.005 + 1e-12
    assert not sent[-1].any()
    assert arm.closed == 2
    np.testing.assert_allclose(found.journal["q_c"][-1], arm.q[[0, 1, 3]], atol=1e-2)
    assert found.journal["missed"][-1] == 0
    assert np.isnan(found.journal["age"][-1])


def test_a_slower_clock_takes_every_second_report_and_counts_what_is_lost(tmp_path: Path) -> None:
    arm = Arm()
    robot = driver(graph_of(tmp_path, "10 ms"), arm)
    robot.connect()
    times = [robot.read().time for _ in range(4)]
    np.testing.assert_allclose(np.diff(times), 0.01)
    for _ in range(7):
        arm.tick()
    found = robot.read()
    assert found.time - times[-1] == pytest.approx(0.035)
    assert found.missed == 3


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"state": 4}, "robot: it is stopped"),
        ({"state": 3}, "robot: it is paused"),
        ({"error_code": 31}, "robot: error 31 of its controller"),
        ({"mode": 0}, "robot: it does not accept velocities any more, mode 0"),
        ({"code": 9}, "lost link: xarm:arm: vc_set_joint_velocity failed with code 9"),
    ],
)
def test_a_fault_of_the_arm_is_named_and_it_is_stopped(graph: dm.Graph, changed: dict[str, Any], message: str) -> None:
    arm = Arm()
    calls = []

    def after() -> str:
        calls.append(1)
        if len(calls) == 10:
            vars(arm).update(changed)
        return ""

    found = driven(graph, driver(graph, arm), 50, ramp=0.1, stop_requested=after)
    assert str(found.stop) == message
    assert arm.calls[-1] == ("set_state", 4)
    assert arm.closed == 2


def test_a_silent_arm_is_lost_and_is_at_rest_within_its_own_patience(graph: dm.Graph) -> None:
    arm = Arm()
    calls = []

    def after() -> str:
        calls.append(1)
        arm.silent = len(calls) >= 10
        return ""

    found = driven(graph, driver(graph, arm), 50, ramp=0.05, stop_requested=after)
    assert str(found.stop) == "lost link: xarm:arm: no report for 25 ms"
    assert arm.calls[-1] == ("set_state", 4)
    arm = Arm()
    robot = driver(graph, arm)
    robot.connect()
    robot.begin()
    robot.command(np.array([0.5, 0.0, 0.0]))  # and then the program is killed
    for _ in range(4):
        arm.tick()
    assert arm.dq[0] == 0.5
    for _ in range(2):
        arm.tick()
    assert arm.dq[0] == 0


def test_it_is_moved_to_the_start_with_the_joints_that_are_held(graph: dm.Graph) -> None:
    arm = Arm()
    arm.q = HELD + 0.1
    found = driven(graph, driver(graph, arm), 3, ramp=0.1, start=HELD[[0, 1, 3]])
    assert found.stop is None
    _, angle, speed, _ = next(row for row in arm.calls if row[0] == "set_servo_angle")
    np.testing.assert_allclose(angle, HELD, atol=1e-7)
    assert speed == 0.25
    assert arm.calls.index(("set_mode", 0)) < [row[0] for row in arm.calls].index("set_servo_angle")
    arm = Arm()
    arm.q[5] = 0.0
    with pytest.raises(DriveError, match=r"expected joint6 at 0.8 rad, where the graph holds it, found it at 0 rad"):
        driven(graph, driver(graph, arm), 3)
    assert not velocities(arm)


def test_a_request_on_the_way_to_the_start_ends_it(graph: dm.Graph) -> None:
    arm = Arm()
    arm.q = HELD + 0.5
    texts = iter(["", "", "Ctrl-C"])
    found = driven(
        graph, driver(graph, arm), 3, ramp=0.1, start=HELD[[0, 1, 3]], stop_requested=lambda: next(texts, "Ctrl-C")
    )
    assert found.stop is not None
    assert "Ctrl-C" in str(found.stop)
    assert arm.calls[-1] == ("set_state", 4)
    assert arm.q[0] > HELD[0] + 0.4
    assert not velocities(arm)


def test_in_shadow_nothing_is_reported_to_it(graph: dm.Graph) -> None:
    arm = Arm()
    found = driven(graph, driver(graph, arm), 20, shadow=True)
    assert found.stop is None
    assert arm.calls == []
    assert arm.closed == 2


def test_what_is_not_a_report_is_reported(graph: dm.Graph) -> None:
    arm = Arm()
    robot = driver(graph, arm)
    robot.connect()
    arm.pending = b"HTTP/1.1 400 Bad Request"
    with pytest.raises(LostError, match="received bytes from port 30000 are not a report"):
        robot.read()


def test_versions_joints_clocks_and_addresses_are_checked(graph: dm.Graph, tmp_path: Path) -> None:
    arm = Arm()
    arm.version_number = (1, 12, 10)
    with pytest.raises(DriveError, match=r"expected firmware 2\.1\.0 or later, .*, found 1\.12\.10"):
        driver(graph, arm).connect()
    assert arm.closed == 1
    assert arm.calls == []
    small = Arm()
    small.axis = 3
    with pytest.raises(DriveError, match="expected an arm with joint4, found one of 3 joints"):
        driver(graph, small).connect()
    kind = kind_of("xarm")[0]
    with pytest.raises(ValueFault, match="expected the address of an arm, xarm:192"):
        kind.make("", graph, Options(1.0))
    late = graph_of(tmp_path, "8 ms")
    with pytest.raises(DriveError, match="a clock of 5 ms or a multiple, the period of the arm's reports, found 8 ms"):
        kind.make("x", late, Options(1.0))
    ur = dm.load("ur10_fast")
    with pytest.raises(DriveError, match="the joints of an xArm, joint1 to joint7, in their order, found shoulder"):
        kind.make("x", ur, Options(1.0))


def test_without_the_package_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarm", None)
    monkeypatch.setitem(sys.modules, "xarm.wrapper", None)
    with pytest.raises(DriveError, match=r"expected the package xarm-python-sdk, found none; .*\[xarm\]"):
        xarm.opened("192.0.2.1")


def test_the_test_double_has_the_calls_of_the_manufacturers_package() -> None:
    wrapper = pytest.importorskip("xarm.wrapper", reason="xarm-python-sdk is not installed")
    for name in ("motion_enable", "set_mode", "set_state", "set_servo_angle", "vc_set_joint_velocity"):
        theirs, mine = (inspect.signature(getattr(owner, name)).parameters for owner in (wrapper.XArmAPI, Arm))
        assert [(item.name, item.kind, item.default) for item in mine.values()] == [
            (item.name, item.kind, item.default) for item in theirs.values()
        ], name
    assert list(inspect.signature(wrapper.XArmAPI.__init__).parameters)[:3] == ["self", "port", "is_radian"]
    for name in ("version_number", "axis", "error_code"):
        assert isinstance(getattr(wrapper.XArmAPI, name), property)


def test_a_report_is_read_as_the_manufacturers_package_reads_it() -> None:
    reader = pytest.importorskip("xarm.x3.report", reason="xarm-python-sdk is not installed")
    random = np.random.default_rng(3)
    numbers = random.uniform(-3, 3, (3, 7))
    data = report(123.456789, 2, 4, *numbers, more=200)
    theirs = reader.ReportDataStructure.create(30000)
    theirs.update(data)
    mine = Report(data)
    assert (mine.state, mine.mode) == (theirs.state, theirs.mode) == (2, 4)
    assert mine.time == pytest.approx(theirs.timestamp * 1e-6)
    for found, expected in (
        (mine.q_c, theirs.target_joint_angle),
        (mine.q, theirs.actual_joint_angle),
        (mine.dq, theirs.actual_joint_velocity),
    ):
        np.testing.assert_array_equal(found, expected)
