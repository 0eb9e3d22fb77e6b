"""A driver for arms of Universal Robots by the package ur_rtde, which is asked for when it is used.

It was tried on no hardware. `dmframe.runtime.ur` is the better one where nothing else asks for this package, which

- goes on with the last speed when its program is killed, unless its watchdog is set: `begin` sets it, to five periods;
- checks neither whether speeds are numbers nor how many there are: `command` does;
- tells its values one by one, so that some may be of the next sample: `read` takes them again then;
- does not wait for the robot's clock: `read` looks for a new time stamp;
- tells nothing of when the robot took a command: ages are not known.
"""

from __future__ import annotations

import importlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, final

import numpy as np

from dmframe.errors import DriveError, LostError, MissingError
from dmframe.runtime.robot import Sample
from dmframe.runtime.ur_arm import ANSWER, PATIENCE, UrArm, way_time

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
"""By RTDE's names the methods of the receiver."""
LOOK: Final = 1 / 40
"""How often a new sample is looked for, in periods."""


@final
class UrRtde:
    """An arm by its address; parameters as of `dmframe.runtime.ur.UniversalRobot`.

    Where the watchdog of ur_rtde ends its script, the maker's controller stops the arm, and how hard is its choice.
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
        self._receive = self._asked(module.RTDEReceiveInterface, self._host, 1 / self.period)
        first, second = (self._newest(self._answer)["timestamp"] for _ in range(2))
        self._arm.check_period(first, second)

    def read(self) -> Sample:
        """See `Robot`; where no sample comes in time, it is lost."""
        return self._arm.sample(self._newest(self._patience), following=self._following, age=None)

    def begin(self) -> None:
        """Have the package send its script, where that was not done for a way, and set the watchdog.

        Raises
        ------
        DriveError
            A joint that the graph holds is elsewhere, so that its tool is, too.
        """
        self._arm.check_held(self._newest(self._answer)["actual_q"])
        control = self._controlled()
        if not self._asked(control.setWatchdog, 1 / (PATIENCE * self.period)):
            raise LostError(f"{self.name}: the watchdog could not be set")
        self._following = True
        self._arm.begin()

    def command(self, dq: np.ndarray) -> None:
        """See `Robot`. Raises `DriveError` for what is no speed of each joint, which the package would send."""
        if dq.shape != (self._arm.n,) or not np.isfinite(dq).all():
            raise DriveError(f"{self.name}: expected {self._arm.n} finite speeds, found {dq.tolist()}")
        control = self._controlled()
        if not self._asked(control.speedJ, self._arm.speeds(dq).tolist(), self._acceleration, self.period):
            raise LostError(f"{self.name}: its script takes no speeds any more")

    def move(self, q: np.ndarray, speed: float, acceleration: float, watched: Callable[[Sample], bool]) -> None:
        """By the package's own `moveJ`, which returns at once; samples tell when it is over."""
        now, goal = np.array(self._newest(self._answer)["actual_q"]), self._arm.pose(q)
        self._asked(self._controlled().moveJ, goal.tolist(), speed, acceleration, True)
        most = way_time(now, goal, speed, acceleration)
        for _ in range(round(most / self.period)):
            told = self._newest(self._answer)
            if watched(self._arm.sample(told, following=False, age=None)):
                return
            if np.max(np.abs(np.array(told["target_q"]) - goal)) < 1e-4:
                self._arm.begin()
                return
        raise LostError(f"{self.name}: expected to be at the start within {most:.0f} s, and is not")

    def stop(self, deceleration: float) -> None:
        """See `Robot`; then the package's script is ended."""
        control, following = self._control, self._following
        self._following = False
        if control is None:  # nothing of ours runs there
            return
        if self._asked(control.isProgramRunning):
            self._asked(control.speedStop if following else control.stopJ, deceleration)
            self._asked(control.stopScript)

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
            self._control = self._asked(module.RTDEControlInterface, self._host)
        return self._control

    def _newest(self, patience: float) -> Mapping[str, Any]:
        """All values of a sample that was not told before. Raises `LostError` where none comes."""
        receive = self._receive
        if receive is None:
            raise LostError(f"{self.name}: there is no connection")
        until = time.monotonic() + patience
        while True:
            told = {name: self._asked(getattr(receive, call)) for name, call in CALLS.items()}
            if told["timestamp"] > self._stamp and self._asked(receive.getTimestamp) == told["timestamp"]:
                self._stamp = told["timestamp"]
                return told
            if time.monotonic() > until or not receive.isConnected():
                raise LostError(f"no sample for {patience * 1e3:.0f} ms")
            time.sleep(LOOK * self.period)

    def _asked(self, call: Callable[..., Any], *given: Any) -> Any:
        """What the package answers. Raises `LostError` for what it raises."""
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
