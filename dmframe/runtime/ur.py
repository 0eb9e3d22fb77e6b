"""Driver of Universal Robots' arms, by RTDE and a script on the robot. Not tested on hardware.

The script reads registers from 24 on (those below are for fieldbuses). It follows velocities as long as a heartbeat
counts up, and stops the arm when the heartbeat stops.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, Final, final

import numpy as np

from dmframe.common.errors import LostError
from dmframe.runtime.arm import PATIENCE, motion_timeout
from dmframe.runtime.robot import Sample
from dmframe.runtime.rtde import PORT, Link, Rtde, Wire
from dmframe.runtime.ur_arm import ANSWER, PLAYING, UrArm

SCRIPTS: Final = 30002
FIRST: Final = 1.0
"""Time for which the script waits for the first heartbeat [s]; the arm does not move meanwhile."""
FASTEST: Final = 6.3
"""Largest joint speed of these arms [rad/s], which bounds the duration of a stop."""
MOST_BEATS: Final = 1 << 30
"""Heartbeats restart above this number, half of a register's range."""
OUTPUTS: Final = {
    "timestamp": "DOUBLE",
    "actual_q": "VECTOR6D",
    "actual_qd": "VECTOR6D",
    "target_q": "VECTOR6D",
    "speed_scaling": "DOUBLE",
    "target_speed_fraction": "DOUBLE",
    "robot_mode": "INT32",
    "safety_mode": "INT32",
    "runtime_state": "UINT32",
    "output_int_register_24": "INT32",
}
INPUTS: Final = {
    "input_int_register_24": "INT32",
    "input_int_register_25": "INT32",
    **{f"input_double_register_{24 + k}": "DOUBLE" for k in range(7)},
}

FOLLOW: Final = """def dmframe_follow():
  global dm_wanted = [0, 0, 0, 0, 0, 0]
  global dm_going = True
  global dm_halt = {halt}
  thread dm_move():
    while dm_going:
      speedj(dm_wanted, {acceleration}, get_steptime())
    end
    stopj(dm_halt)
  end
  dm_beat = read_input_integer_register(24)
  dm_started = False
  dm_silent = 0
  dm_most = {first}
  dm_mover = run dm_move()
  while dm_silent < dm_most:
    dm_now = read_input_integer_register(24)
    if dm_now == dm_beat:
      dm_silent = dm_silent + get_steptime()
    else:
      dm_silent = 0
      dm_beat = dm_now
      dm_started = True
      dm_most = {patience}
    end
    if dm_started:
      if read_input_integer_register(25) == 0:
        dm_silent = dm_most
        dm_halt = read_input_float_register(30)
      else:
        dm_wanted[0] = read_input_float_register(24)
        dm_wanted[1] = read_input_float_register(25)
        dm_wanted[2] = read_input_float_register(26)
        dm_wanted[3] = read_input_float_register(27)
        dm_wanted[4] = read_input_float_register(28)
        dm_wanted[5] = read_input_float_register(29)
      end
    end
    write_output_integer_register(24, dm_beat)
    sync()
  end
  dm_going = False
  join dm_mover
end
"""
"""The thread that moves the joints also stops them: two moving threads are an error, and between the end of one and
`stopj` in another a cycle passes, in which the arm decelerates with the acceleration of `speedj`.

Registers keep the speeds of a client that was killed, and are ignored until the heartbeat changes.
"""


@final
class UniversalRobot:
    """Driver of an arm at a network address.

    Parameters
    ----------
    joints
        Joints of the graph, in its order; the others of the six are held.
    tool
        q -> x, the graph's kinematics; the robot's own pose is in another frame.
    held
        Angles of the held joints in the graph [rad]; 0 by default.
    acceleration, halt
        Acceleration with which the script follows commands, and deceleration without a heartbeat [rad/s^2].
    patience
        Timeout of a sample [s], five periods by default. The script's timeout is always five periods.
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
        acceleration: float = 40.0,
        halt: float = 20.0,
        patience: float | None = None,
        linked: Callable[[str, int], Link] = Wire,
    ) -> None:
        self.name, self.period = f"ur:{host}", period
        self._host, self._linked = host, linked
        self._arm = UrArm(self.name, period, joints, tool, held)
        self._script = FOLLOW.format(
            acceleration=acceleration,
            halt=halt,
            first=FIRST,
            patience=round((PATIENCE - 0.5) * period, 6),  # half a period below the sum that exceeds it
        )
        self._patience = PATIENCE * period if patience is None else patience
        self._answer = max(ANSWER, self._patience)
        self._rtde: Rtde | None = None
        self._beat, self._following = 0, False
        self._sent, self._scripted = dict[int, float](), False

    def connect(self) -> None:
        """See `Robot`.

        Raises
        ------
        DriveError
            The arm's cycle does not divide the period, so that its samples have another period.
        """
        link = self._linked(self._host, PORT)
        try:
            self._rtde = Rtde(link, 1 / self.period, OUTPUTS, INPUTS, self._answer)
        except BaseException:
            link.close()
            raise
        first, second = (self._newest(self._answer)["timestamp"] for _ in range(2))
        self._arm.check_period(first, second)

    def read(self) -> Sample:
        """See `Robot`."""
        return self._sample(self._newest(self._patience))

    def begin(self) -> None:
        """Send the script and wait for its heartbeat.

        Raises
        ------
        DriveError
            A held joint is not at the graph's angle, so that the tool position differs.
        """
        values = self._newest(self._answer)
        self._arm.check_held(values["actual_q"])
        echo = values["output_int_register_24"]
        # do not count the echo that another client has left
        first = self._beat = max(self._beat, echo + 1) if echo < MOST_BEATS else 0
        self._upload(self._script)
        for _ in range(round(5 / self.period)):
            self._write(np.zeros(6), 1)
            values = self._newest(self._answer)
            if first <= values["output_int_register_24"] < self._beat and values["runtime_state"] == PLAYING:
                self._following = True
                self._arm.begin()
                self._write(np.zeros(6), 1)  # each sample is answered; the loop answers the next one
                return
        raise LostError(f"{self.name}: its script does not answer; is the arm in remote control?")

    def command(self, dq: np.ndarray) -> None:
        """See `Robot`."""
        self._write(self._arm.speeds(dq), 1)

    def move(self, q: np.ndarray, speed: float, acceleration: float, watched: Callable[[Sample], bool]) -> None:
        """See `Robot`; uses UR's `movej`."""
        now, goal = np.array(self._newest(self._answer)["actual_q"]), self._arm.pose(q)
        text = ", ".join(f"{angle:.9f}" for angle in goal)
        self._upload(f"def dmframe_move():\n  movej([{text}], a={acceleration}, v={speed})\nend\n")
        most = motion_timeout(now, goal, speed, acceleration)
        for _ in range(round(most / self.period)):
            values = self._newest(self._answer)
            if watched(self._sample(values)):
                return
            arrived = np.max(np.abs(np.array(values["target_q"]) - goal)) < 1e-4
            if arrived and values["runtime_state"] != PLAYING:
                self._arm.begin()
                return
        raise LostError(f"{self.name}: the motion to the start did not end within {most:.0f} s")

    def stop(self, deceleration: float) -> None:
        """See `Robot`; if the script does not stop the arm, another script is sent."""
        if self._rtde is None or not self._scripted:  # no script was sent
            return
        following, self._following = self._following, False
        with suppress(LostError):  # the other port may still work
            for _ in range(round((1 + FASTEST / deceleration) / self.period) if following else 0):
                self._write(np.zeros(6), 0, deceleration)
                values = self._newest(self._patience)
                if values["runtime_state"] != PLAYING:
                    return
        self._upload(f"def dmframe_stop():\n  stopj({deceleration})\nend\n")

    def close(self) -> None:
        """See `Robot`."""
        if self._rtde is not None:
            self._rtde.close()
            self._rtde = None

    def _newest(self, patience: float) -> Any:
        if self._rtde is None:
            raise LostError(f"{self.name}: there is no connection")
        return self._rtde.read(patience)

    def _write(self, dq: np.ndarray, follow: int, deceleration: float = 0.0) -> None:
        if self._rtde is None:
            raise LostError(f"{self.name}: there is no connection")
        self._rtde.write(self._beat, follow, *dq.tolist(), deceleration)
        self._sent[self._beat] = time.monotonic()
        self._sent.pop(self._beat - 1000, None)
        self._beat += 1

    def _upload(self, script: str) -> None:
        self._scripted = True
        link = self._linked(self._host, SCRIPTS)
        try:
            link.send(script.encode())
        finally:
            link.close()

    def _sample(self, values: Any) -> Sample:
        sent = self._sent.get(values["output_int_register_24"])
        age = time.monotonic() - sent if sent is not None and self._following else None
        return self._arm.sample(values, following=self._following, age=age)
