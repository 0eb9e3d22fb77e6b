"""A driver for arms of UFACTORY (xArm 5, 6, 7), by the maker's package xarm-python-sdk and its port of reports.

It was tried on no hardware. Samples come from port 30000, 200 a second by the arm's own clock, which tell the target of
the servo too; velocities go through the package, each with a time after which the arm comes to rest by itself.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, Final, Protocol, final

import numpy as np

from dmframe.errors import DriveError, LostError
from dmframe.runtime.robot import Sample
from dmframe.runtime.rtde import Link, Wire

REPORTS: Final = 30000
REPORT: Final = 0.005
"""From one report to the next [s]."""
FIRMWARE: Final = (2, 1, 0)
"""The first whose reports are laid out so."""
JOINTS: Final = tuple(f"joint{k + 1}" for k in range(7))
PATIENCE: Final = 5
"""Periods without a command after which the arm comes to rest by itself, and without a sample after which we do."""
AWAY: Final = 0.01
"""How far a joint may be from where the graph holds it [rad]."""
BY_POSITION, BY_VELOCITY = 0, 4
MOVES, STOPS = 0, 4
READY: Final = (0, 1, 2)
STATES: Final = {3: "it is paused", 4: "it is stopped", 5: "its system was reset", 6: "it comes to a stop"}

# size, time [us], state and mode; then numbers of the joints: target q, dq, ddq and measured q, dq
_HEAD: Final = struct.Struct(">IQB")
_FIRST, _JOINTS = 32, struct.Struct("<35f")
_LONGEST: Final = 1 << 16


class Api(Protocol):
    """What is used of the maker's ``XArmAPI``; most calls return a code, 0 for success."""

    version_number: Any
    axis: Any
    error_code: Any

    def motion_enable(self, enable: bool = ...) -> Any:
        """Switch the motors on."""

    def set_mode(self, mode: int = ...) -> Any:
        """By position, by velocity."""

    def set_state(self, state: int = ...) -> Any:
        """Move, stop."""

    def set_servo_angle(
        self, *, angle: Any = ..., speed: Any = ..., mvacc: Any = ..., is_radian: Any = ..., wait: bool = ...
    ) -> Any:
        """Go to a pose."""

    def vc_set_joint_velocity(
        self, speeds: Any, is_radian: Any = ..., is_sync: bool = ..., duration: float = ...
    ) -> Any:
        """Move with velocities for a time."""

    def disconnect(self) -> Any:
        """Let go."""


def opened(host: str) -> Api:
    """The maker's own. Raises `DriveError` where its package is missing, `LostError` where nobody answers."""
    try:
        from xarm.wrapper import XArmAPI
    except ImportError:
        raise DriveError(
            "--robot xarm: expected the package xarm-python-sdk, found none; install it: pip install 'dmframe[xarm]'"
        ) from None
    try:
        api: Api = XArmAPI(host, is_radian=True)
    except Exception as error:  # the package raises Exception itself
        raise LostError(f"xarm:{host}: expected an arm, and nobody answers: {error}") from None
    return api


@final
class XArm:
    """An arm by its address.

    Parameters
    ----------
    joints
        The graph's, in its order; the others of the arm are held where the graph holds them.
    tool
        q -> x, the graph's own kinematics: the maker's pose depends on what is set as the tool.
    held
        Where the graph holds the others [rad]; 0 without a word.
    patience
        How long to wait for a sample [s]; five periods without it. A command holds for five periods anyway.
    opened
        Makes the maker's object from an address.
    linked
        Opens a connection to a port; by TCP without it.
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
        opened: Callable[[str], Api] = opened,
        linked: Callable[[str, int], Link] = Wire,
    ) -> None:
        self.name, self.period = f"xarm:{host}", period
        self._patience = PATIENCE * period if patience is None else patience
        if abs(period / REPORT - round(period / REPORT)) > 1e-9 or period < REPORT / 2:
            raise DriveError(
                f"{self.name}: expected a clock of whole reports of the arm, 5 ms or a multiple, found "
                f"{period * 1e3:g} ms"
            )
        self._host, self._opened, self._linked, self._tool = host, opened, linked, tool
        self._places, self._holds = [JOINTS.index(name) for name in joints], dict(held)
        self._api: Api | None = None
        self._link: Link | None = None
        self._buffer, self._last, self._axes = b"", float("nan"), 7
        self._following = self._moved = False
        self._sent = np.zeros(7)

    def connect(self) -> None:
        """See `Robot`."""
        api = self._api = self._opened(self._host)
        try:
            found = tuple(api.version_number)
            if found < FIRMWARE:
                raise DriveError(
                    f"{self.name}: expected firmware {_dotted(FIRMWARE)} or later, whose reports tell the servo's "
                    f"target, found {_dotted(found)}"
                )
            self._axes = int(api.axis)
            if max(self._places) >= self._axes:
                raise DriveError(
                    f"{self.name}: expected an arm with {JOINTS[max(self._places)]}, found one of {self._axes} joints"
                )
            self._link = self._linked(self._host, REPORTS)
        except BaseException:
            self.close()
            raise

    def read(self) -> Sample:
        """See `Robot`; after five periods without a sample it is lost."""
        return self._told(self._newest(self._patience))

    def begin(self) -> None:
        """Let it take velocities, and wait until it says so.

        Raises
        ------
        DriveError
            A joint that the graph holds is elsewhere, so that its tool is, too.
        """
        q = self._newest(self._patience).q
        for k, angle in self._held():
            if abs(q[k] - angle) > AWAY:
                raise DriveError(
                    f"{self.name}: expected {JOINTS[k]} at {angle:.4g} rad, where the graph holds it, found it at "
                    f"{q[k]:.4g} rad"
                )
        self._put_in(BY_VELOCITY)
        for _ in range(round(5 / self.period)):
            told = self._newest(self._patience)
            if told.mode == BY_VELOCITY and told.state in READY:
                self._following, self._sent, self._last = True, np.zeros(7), float("nan")
                return
        raise LostError(f"{self.name}: it does not take velocities: mode {told.mode}, state {told.state}")

    def command(self, dq: np.ndarray) -> None:
        """See `Robot`; it holds for five periods at most."""
        wanted = np.zeros(7)
        wanted[self._places] = dq
        self._send(wanted)

    def move(self, q: np.ndarray, speed: float, acceleration: float, watched: Callable[[Sample], bool]) -> None:
        """By the maker's own motion to joint angles; its stop state ends it."""
        now = self._newest(2.0).q
        goal = now.copy()
        goal[self._places] = q
        for k, angle in self._held():
            goal[k] = angle
        goal, now = goal[: self._axes], now[: self._axes]
        self._put_in(BY_POSITION)
        api = self._connected()
        self._done(
            "set_servo_angle",
            api.set_servo_angle(angle=goal.tolist(), speed=speed, mvacc=acceleration, is_radian=True, wait=False),
        )
        most = float(np.max(np.abs(goal - now))) / speed + 2 * speed / acceleration + 5
        for _ in range(round(most / self.period)):
            told = self._newest(2.0)
            if watched(self._told(told)):
                return
            apart = np.max(np.abs(told.q_c[: self._axes] - goal))
            if apart < 1e-4 and np.max(np.abs(told.dq[: self._axes])) < 1e-2:
                self._last = float("nan")
                return
        raise LostError(f"{self.name}: expected to be at the start within {most:.0f} s, and is not")

    def stop(self, deceleration: float) -> None:
        """Velocities go down; then its state is that of a stop, in which it stays until somebody lets it move again."""
        api = self._api
        if api is None or not self._moved:  # nothing of ours moves it
            return
        following, self._following = self._following, False
        with suppress(LostError):  # the state may still be set
            while following and self._sent.any():
                self._send(np.sign(self._sent) * np.maximum(np.abs(self._sent) - deceleration * self.period, 0))
                told = self._newest(self._patience)
                following = told.mode == BY_VELOCITY and told.state in READY
        self._done("set_state", api.set_state(STOPS))

    def close(self) -> None:
        """See `Robot`."""
        if self._link is not None:
            self._link.close()
            self._link = None
        if self._api is not None:
            self._api.disconnect()
            self._api = None

    def _held(self) -> list[tuple[int, float]]:
        """Joints that the graph holds, and where."""
        return [(k, self._holds.get(JOINTS[k], 0.0)) for k in range(self._axes) if k not in self._places]

    def _connected(self) -> Api:
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
        # each joint by itself: with all in step the slowest would change the others' velocities
        speeds = wanted[: self._axes].tolist()
        code = self._connected().vc_set_joint_velocity(
            speeds, is_radian=True, is_sync=False, duration=PATIENCE * self.period
        )
        self._done("vc_set_joint_velocity", code)
        self._sent = wanted

    def _done(self, what: str, code: Any) -> None:
        if code != 0:
            raise LostError(f"{self.name}: {what} was not taken, with code {code} of its package")

    def _newest(self, patience: float) -> Report:
        """The first report of the next period, or the newest after it."""
        if self._link is None:
            raise LostError(f"{self.name}: there is no connection")
        while True:
            found = self._waiting()
            # half a report early: the arm's clock and ours need not agree to the microsecond
            if found is not None and not found.time < self._last + self.period - REPORT / 2:
                self._buffer += self._link.receive(0.0)
                newest = self._waiting() or found
                steps, self._last = (newest.time - self._last) / self.period, newest.time
                newest.missed = max(0, round(steps) - 1) if np.isfinite(steps) else 0
                return newest
            data = self._link.receive(patience)
            if not data:
                raise LostError(f"{self.name}: no report for {patience * 1e3:.0f} ms")
            self._buffer += data

    def _waiting(self) -> Report | None:
        """The newest whole report of the buffer; those before it are dropped."""
        newest = None
        while len(self._buffer) >= 4:
            (size,) = struct.unpack_from(">I", self._buffer)
            if not _FIRST + _JOINTS.size <= size <= _LONGEST:
                raise LostError(f"{self.name}: what comes from port {REPORTS} is no report")
            if len(self._buffer) < size:
                break
            newest, self._buffer = Report(self._buffer[:size]), self._buffer[size:]
        return newest

    def _fault(self, told: Report) -> str:
        if code := int(self._connected().error_code or 0):
            return f"error {code} of its controller"
        if self._following and told.mode != BY_VELOCITY:
            return f"it does not take velocities any more, mode {told.mode}"
        return STATES.get(told.state, "") if self._moved else ""

    def _told(self, told: Report) -> Sample:
        q = told.q[self._places]
        return Sample(
            time=told.time,
            q=q,
            dq=told.dq[self._places],
            q_c=told.q_c[self._places],
            x=np.asarray(self._tool(q)).ravel(),
            ready=told.state in READY,
            fault=self._fault(told),
            missed=told.missed,
        )


@final
class Report:
    """What the arm tells at one instant; (7,) each, of an arm with fewer joints the first ones.

    `missed` says how many samples were lost since the one before.
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
