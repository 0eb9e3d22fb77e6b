"""Driver of Universal Robots' arms by the optional package ur_rtde. Not tested on hardware.

Prefer `dmframe.runtime.ur`, unless this package is required. The package

- continues with the last speed when its program is killed, unless its watchdog is set: `begin` sets it to five periods;
- checks neither that speeds are finite nor how many there are: `command` does;
- returns values one by one, so that some may belong to the next sample: `read` then reads them again;
- does not wait for the robot's clock: `read` polls the time stamp;
- does not report when the robot received a command: ages are unknown.
"""

from __future__ import annotations

import importlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, final

import numpy as np

from dmframe.common.errors import DriveError, LostError, MissingError
from dmframe.runtime.arm import PATIENCE, motion_timeout
from dmframe.runtime.robot import Sample
from dmframe.runtime.ur_arm import ANSWER, UrArm

CALLS: Final = {
    "timestamp": "getTimestamp",
    "actual_q": "getActualQ",
    "actual_qd": "getActualQd",
    "target_q": "getTargetQ",
    "speed_scaling": "getSpeedScaling",
    "target_speed_fraction": "getTargetSpeedFraction",
    "robot_mode": "getRobotMode",
    "safety_mode": "getSafetyMode",
    "runtime_state": "getRuntimeState",
}
"""RTDE name -> method of the receiver."""
LOOK: Final = 1 / 40
"""Polling interval for a new sample [periods]."""


@final
class UrRtde:
    """Driver of an arm at a network address; parameters as in `dmframe.runtime.ur.UniversalRobot`.

    If the watchdog of ur_rtde ends its script, the robot's controller stops the arm with its own deceleration.
    """

    def __init__(
        self,
        host: str,
        period: float,
        joints: Sequence[str],
        tool: Callable[[np.ndarray], np.ndarray],
        held: Mapping[str, float],
        *,
        acceleration: float = 40.0,
        patience: float | None = None,
    ) -> None:
        self.name, self.period = f"ur_rtde:{host}", period
        self._host, self._acceleration = host, acceleration
        self._arm = UrArm(self.name, period, joints, tool, held)
        self._patience = PATIENCE * period if patience is None else patience
        self._answer = max(ANSWER, self._patience)
        self._receive: Any = None
        self._control: Any = None
        self._stamp, self._following = -math.inf, False

    def connect(self) -> None:
        """See `Robot`.

        Raises
        ------
        MissingError
            The package is not installed.
        DriveError
            The arm's cycle does not divide the period.
        """
        module = _module("rtde_receive")
        self._receive = self._call(module.RTDEReceiveInterface, self._host, 1 / self.period)
        first, second = (self._newest(self._answer)["timestamp"] for _ in range(2))
        self._arm.check_period(first, second)

    def read(self) -> Sample:
        """See `Robot`."""
        return self._arm.sample(self._newest(self._patience), following=self._following, age=None)

    def begin(self) -> None:
        """Start the package's script, unless it runs, and set the watchdog.

        Raises
        ------
        DriveError
            A held joint is not at the graph's angle, so that the tool position differs.
        """
        self._arm.check_held(self._newest(self._answer)["actual_q"])
        control = self._controlled()
        if not self._call(control.setWatchdog, 1 / (PATIENCE * self.period)):
            raise LostError(f"{self.name}: the watchdog could not be set")
        self._following = True
        self._arm.begin()

    def command(self, dq: np.ndarray) -> None:
        """See `Robot`. Raises `DriveError` for a wrong number of speeds, or one that is not finite."""
        n = len(self._arm.places)
        if dq.shape != (n,) or not np.isfinite(dq).all():
            raise DriveError(f"{self.name}: expected {n} finite speeds, found {dq.tolist()}")
        control = self._controlled()
        if not self._call(control.speedJ, self._arm.speeds(dq).tolist(), self._acceleration, self.period):
            raise LostError(f"{self.name}: its script does not accept speeds any more")

    def move(self, q: np.ndarray, speed: float, acceleration: float, watched: Callable[[Sample], bool]) -> None:
        """See `Robot`; uses the package's asynchronous `moveJ`."""
        now, goal = np.array(self._newest(self._answer)["actual_q"]), self._arm.pose(q)
        self._call(self._controlled().moveJ, goal.tolist(), speed, acceleration, True)
        most = motion_timeout(now, goal, speed, acceleration)
        for _ in range(round(most / self.period)):
            values = self._newest(self._answer)
            if watched(self._arm.sample(values, following=False, age=None)):
                return
            if np.max(np.abs(np.array(values["target_q"]) - goal)) < 1e-4:
                self._arm.begin()
                return
        raise LostError(f"{self.name}: the motion to the start did not end within {most:.0f} s")

    def stop(self, deceleration: float) -> None:
        """See `Robot`; ends the package's script, too."""
        control, following = self._control, self._following
        self._following = False
        if control is None:  # no script was started
            return
        if self._call(control.isProgramRunning):
            self._call(control.speedStop if following else control.stopJ, deceleration)
            self._call(control.stopScript)

    def close(self) -> None:
        """See `Robot`."""
        for name in ("_control", "_receive"):
            held = getattr(self, name)
            setattr(self, name, None)
            if held is not None:
                held.disconnect()

    def _controlled(self) -> Any:
        if self._control is None:
            module = _module("rtde_control")
            self._control = self._call(module.RTDEControlInterface, self._host)
        return self._control

    def _newest(self, patience: float) -> Mapping[str, Any]:
        """Values of a new sample. Raises `LostError` after the timeout."""
        receive = self._receive
        if receive is None:
            raise LostError(f"{self.name}: there is no connection")
        until = time.monotonic() + patience
        while True:
            values = {name: self._call(getattr(receive, call)) for name, call in CALLS.items()}
            if values["timestamp"] > self._stamp and self._call(receive.getTimestamp) == values["timestamp"]:
                self._stamp = values["timestamp"]
                return values
            if time.monotonic() > until or not receive.isConnected():
                raise LostError(f"no sample for {patience * 1e3:.0f} ms")
            time.sleep(LOOK * self.period)

    def _call(self, call: Callable[..., Any], *given: Any) -> Any:
        """Call a function of the package. Raises `LostError` for its exceptions."""
        try:
            return call(*given)
        except RuntimeError as error:
            raise LostError(f"{self.name}: {str(error).strip() or 'ur_rtde has failed'}") from None


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        raise MissingError(
            "--robot ur_rtde: expected the package ur_rtde, found none: python -m pip install ur_rtde"
        ) from None
