"""Driver of UFACTORY arms (xArm 5, 6, 7), by the package xarm-python-sdk and the report port. Not tested on hardware.

Samples, including the servo's target, come from port 30000 at 200 Hz of the arm's clock. Velocities are sent through
the package, each with a duration after which the arm stops by itself.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, Final, final

import numpy as np

from dmframe.common.errors import DriveError, LostError
from dmframe.common.version import installing
from dmframe.runtime.arm import PATIENCE, ArmJoints, motion_timeout
from dmframe.runtime.robot import Sample
from dmframe.runtime.rtde import Link, Wire

REPORTS: Final = 30000
REPORT: Final = 0.005
"""Period of reports [s]."""
FIRMWARE: Final = (2, 1, 0)
"""First version with this layout of reports."""
JOINTS: Final = tuple(f"joint{k + 1}" for k in range(7))
BY_POSITION, BY_VELOCITY = 0, 4
MOVES, STOPS = 0, 4
READY: Final = (0, 1, 2)
STATES: Final = {3: "it is paused", 4: "it is stopped", 5: "its system was reset", 6: "it comes to a stop"}

# size, time [us], state and mode; then by joint: target q, dq, ddq and measured q, dq
_HEAD: Final = struct.Struct(">IQB")
_FIRST, _JOINTS = 32, struct.Struct("<35f")
_LONGEST: Final = 1 << 16


def opened(host: str) -> Any:
    """Connect ``XArmAPI``. Raises `DriveError` if the package is missing, `LostError` if the arm does not answer."""
    try:
        from xarm.wrapper import XArmAPI
    except ImportError:
        raise DriveError(
            f"--robot xarm: expected the package xarm-python-sdk, found none; install it: {installing('xarm')}"
        ) from None
    try:
        return XArmAPI(host, is_radian=True)
    except Exception as error:  # the package raises Exception itself
        raise LostError(f"xarm:{host}: no arm answers: {error}") from None


@final
class XArm:
    """Driver of an arm at a network address.

    Parameters
    ----------
    joints
        Joints of the graph, in its order; the others are held.
    tool
        q -> x, the graph's kinematics; the arm's own pose depends on its tool setting.
    held
        Angles of the held joints in the graph [rad]; 0 by default.
    patience
        Timeout of a sample [s], five periods by default. A command always lasts five periods.
    opened
        Connects ``XArmAPI`` to an address.
    linked
        Opens a connection to a port, by default over TCP.
    """

    def __init__(
        self,
        host: str,
        period: float,
        joints: Sequence[str],
        tool: Callable[[np.ndarray], np.ndarray],
        held: Mapping[str, float],
        *,
        patience: float | None = None,
        opened: Callable[[str], Any] = opened,
        linked: Callable[[str, int], Link] = Wire,
    ) -> None:
        self.name, self.period = f"xarm:{host}", period
        self._patience = PATIENCE * period if patience is None else patience
        if abs(period / REPORT - round(period / REPORT)) > 1e-9 or period < REPORT / 2:
            raise DriveError(
                f"{self.name}: expected a clock of 5 ms or a multiple, the period of the arm's reports, found "
                f"{period * 1e3:g} ms"
            )
        self._host, self._opened, self._linked, self._tool = host, opened, linked, tool
        self._arm = ArmJoints(self.name, period, JOINTS, joints, held)
        self._api: Any = None
        self._link: Link | None = None
        self._buffer, self._axes = b"", 7
        self._following = self._moved = False
        self._sent = np.zeros(7)

    def connect(self) -> None:
        """See `Robot`."""
        api = self._api = self._opened(self._host)
        try:
            found = tuple(api.version_number)
            if found < FIRMWARE:
                raise DriveError(
                    f"{self.name}: expected firmware {_dotted(FIRMWARE)} or later, whose reports have the servo's "
                    f"target, found {_dotted(found)}"
                )
            self._axes = int(api.axis)
            if (last := max(self._arm.places)) >= self._axes:
                raise DriveError(f"{self.name}: expected an arm with {JOINTS[last]}, found one of {self._axes} joints")
            self._arm.held = {k: angle for k, angle in self._arm.held.items() if k < self._axes}
            self._link = self._linked(self._host, REPORTS)
        except BaseException:
            self.close()
            raise

    def read(self) -> Sample:
        """See `Robot`."""
        return self._sample(self._newest(self._patience))

    def begin(self) -> None:
        """Select velocity control, and wait until the arm reports it.

        Raises
        ------
        DriveError
            A held joint is not at the graph's angle, so that the tool position differs.
        """
        self._arm.check_held(self._newest(self._patience).q)
        self._put_in(BY_VELOCITY)
        for _ in range(round(5 / self.period)):
            report = self._newest(self._patience)
            if report.mode == BY_VELOCITY and report.state in READY:
                self._following, self._sent = True, np.zeros(7)
                self._arm.begin()
                return
        raise LostError(f"{self.name}: it does not accept velocities: mode {report.mode}, state {report.state}")

    def command(self, dq: np.ndarray) -> None:
        """See `Robot`; a command lasts at most five periods."""
        self._send(self._arm.speeds(dq))

    def move(self, q: np.ndarray, speed: float, acceleration: float, watched: Callable[[Sample], bool]) -> None:
        """See `Robot`; uses the arm's motion to joint angles."""
        now, goal = (each[: self._axes] for each in (self._newest(2.0).q, self._arm.pose(q)))
        self._put_in(BY_POSITION)
        api = self._connected()
        self._done(
            "set_servo_angle",
            api.set_servo_angle(angle=goal.tolist(), speed=speed, mvacc=acceleration, is_radian=True, wait=False),
        )
        most = motion_timeout(now, goal, speed, acceleration)
        for _ in range(round(most / self.period)):
            report = self._newest(2.0)
            if watched(self._sample(report)):
                return
            distance = np.max(np.abs(report.q_c[: self._axes] - goal))
            if distance < 1e-4 and np.max(np.abs(report.dq[: self._axes])) < 1e-2:
                self._arm.begin()
                return
        raise LostError(f"{self.name}: the motion to the start did not end within {most:.0f} s")

    def stop(self, deceleration: float) -> None:
        """See `Robot`; the arm then remains in its stop state."""
        api = self._api
        if api is None or not self._moved:  # this driver has not moved it
            return
        following, self._following = self._following, False
        with suppress(LostError):  # the state may still be set
            while following and self._sent.any():
                self._send(np.sign(self._sent) * np.maximum(np.abs(self._sent) - deceleration * self.period, 0))
                report = self._newest(self._patience)
                following = report.mode == BY_VELOCITY and report.state in READY
        self._done("set_state", api.set_state(STOPS))

    def close(self) -> None:
        """See `Robot`."""
        if self._link is not None:
            self._link.close()
            self._link = None
        if self._api is not None:
            self._api.disconnect()
            self._api = None

    def _connected(self) -> Any:
        if self._api is None:
            raise LostError(f"{self.name}: there is no connection")
        return self._api

    def _put_in(self, mode: int) -> None:
        api = self._connected()
        self._moved = True
        self._done("motion_enable", api.motion_enable(True))
        self._done("set_mode", api.set_mode(mode))
        self._done("set_state", api.set_state(MOVES))

    def _send(self, wanted: np.ndarray) -> None:
        # not synchronised: the slowest joint would change the others' velocities
        speeds = wanted[: self._axes].tolist()
        code = self._connected().vc_set_joint_velocity(
            speeds, is_radian=True, is_sync=False, duration=PATIENCE * self.period
        )
        self._done("vc_set_joint_velocity", code)
        self._sent = wanted

    def _done(self, what: str, code: Any) -> None:
        if code != 0:
            raise LostError(f"{self.name}: {what} failed with code {code}")

    def _newest(self, patience: float) -> Report:
        """First report of the next period, or the newest one after it."""
        if self._link is None:
            raise LostError(f"{self.name}: there is no connection")
        while True:
            found = self._waiting()
            # half a report early: the two clocks need not agree to the microsecond
            if found is not None and not found.time < self._arm.last + self.period - REPORT / 2:
                self._buffer += self._link.receive(0.0)
                newest = self._waiting() or found
                newest.missed = self._arm.missed(newest.time)
                return newest
            data = self._link.receive(patience)
            if not data:
                raise LostError(f"{self.name}: no report for {patience * 1e3:.0f} ms")
            self._buffer += data

    def _waiting(self) -> Report | None:
        """Newest complete report of the buffer; older ones are dropped."""
        newest = None
        while len(self._buffer) >= 4:
            (size,) = struct.unpack_from(">I", self._buffer)
            if not _FIRST + _JOINTS.size <= size <= _LONGEST:
                raise LostError(f"{self.name}: received bytes from port {REPORTS} are not a report")
            if len(self._buffer) < size:
                break
            newest, self._buffer = Report(self._buffer[:size]), self._buffer[size:]
        return newest

    def _fault(self, report: Report) -> str:
        if code := int(self._connected().error_code or 0):
            return f"error {code} of its controller"
        if self._following and report.mode != BY_VELOCITY:
            return f"it does not accept velocities any more, mode {report.mode}"
        return STATES.get(report.state, "") if self._moved else ""

    def _sample(self, report: Report) -> Sample:
        places = self._arm.places
        q = report.q[places]
        return Sample(
            time=report.time,
            q=q,
            dq=report.dq[places],
            q_c=report.q_c[places],
            x=np.asarray(self._tool(q)).ravel(),
            ready=report.state in READY,
            fault=self._fault(report),
            missed=report.missed,
        )


@final
class Report:
    """Report of the arm; arrays are (7,), and an arm with fewer joints uses the first elements.

    `missed` is the number of samples lost before this one.
    """

    missed = 0

    def __init__(self, data: bytes) -> None:
        _, microseconds, state = _HEAD.unpack_from(data)
        numbers = np.array(_JOINTS.unpack_from(data, _FIRST)).reshape(5, 7)
        self.time = microseconds * 1e-6
        self.state, self.mode = state & 15, state >> 4
        self.q_c, self.q, self.dq = numbers[0], numbers[3], numbers[4]


def _dotted(version: Sequence[Any]) -> str:
    return ".".join(map(str, version))
