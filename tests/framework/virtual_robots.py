"""Virtual robots for tests, and a client of theirs at byte level."""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

import dmframe as dm
from dmframe.common.errors import LostError
from dmframe.runtime.rtde import PORT
from dmframe.virtual import VirtualRobot
from dmframe.virtual.program import Program
from dmframe.virtual.rtde import Rtde


@cache
def graph(name: str) -> dm.Graph:
    """A packaged graph, wired once."""
    found = dm.load(name)
    assert found.diagram is not None
    return found


def robot(name: str = "ur10_fast", **behaviour: Any) -> VirtualRobot:
    """A robot at its start."""
    return graph(name).virtual_robot(**behaviour)


def own_host() -> str:
    """An address of this machine that only this process uses, since some clients support only UR's default ports."""
    number = os.getpid()
    return f"127.{40 + number % 80}.{number // 80 % 250}.{2 + number // 20000 % 250}"


def runs(held: VirtualRobot, script: str, cycles: int = 2000) -> VirtualRobot:
    """Run a script to its end."""
    held.load_script(script)
    for _ in range(cycles):
        if not held.running:
            return held
        held.advance()
    raise AssertionError(f"still runs after {cycles} cycles: {list(held.messages)}")


def message(kind: str, payload: bytes = b"") -> bytes:
    """A message of RTDE, as in its guide."""
    return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload


class Client:
    """A client of RTDE, without a socket."""

    def __init__(self, held: VirtualRobot, others: list[Rtde] | None = None) -> None:
        self.robot = held
        self.rtde = Rtde(held, [] if others is None else others)

    def received(self) -> list[tuple[str, bytes]]:
        """Received messages: kinds and payloads."""
        data, found = bytes(self.rtde.pending), []
        self.rtde.pending.clear()
        while data:
            length, kind = struct.unpack(">HB", data[:3])
            found.append((chr(kind), data[3:length]))
            data = data[length:]
        return found

    def request(self, kind: str, payload: bytes = b"") -> tuple[str, bytes]:
        """One message, and its answer."""
        self.rtde.received(message(kind, payload))
        (answer,) = self.received()
        return answer

    def begin(self, outputs: Sequence[str], inputs: Sequence[str] = (), frequency: float | None = None) -> None:
        """From the version to the first sample."""
        rate = 1 / self.robot.dt if frequency is None else frequency
        assert self.request("V", b"\0\2") == ("V", b"\1")
        assert self.request("O", struct.pack(">d", rate) + ",".join(outputs).encode())[1][0] == 1
        if inputs:
            assert self.request("I", ",".join(inputs).encode())[1][0] == 1
        assert self.request("S") == ("S", b"\1")

    def samples(self, form: str) -> list[tuple[Any, ...]]:
        """The received samples, unpacked by `struct`."""
        return [struct.unpack(f">{form}", payload[1:]) for kind, payload in self.received() if kind == "U"]

    def write(self, form: str, *values: Any) -> None:
        """Inputs of the first recipe."""
        self.rtde.received(message("U", b"\1" + struct.pack(f">{form}", *values)))


FOLLOW = """
def follow():
  # what a client writes to registers 24 to 29 the joints do, as long as it counts register 24 up
  global wanted = [0, 0, 0, 0, 0, 0]
  global going = True
  thread mover():
    while going:
      speedj(wanted, 40, get_steptime())
    end
  end
  last = read_input_integer_register(24)
  silent = 0
  moving = run mover()
  while silent < 5:
    beat = read_input_integer_register(24)
    if beat == last:
      silent = silent + 1
    else:
      silent = 0
      last = beat
    end
    k = 0
    while k < 6:
      wanted[k] = read_input_float_register(24 + k)
      k = k + 1
    end
    write_output_integer_register(24, beat)
    sync()
  end
  going = False
  join moving
  stopj(10)
  textmsg("the client is silent")
end
"""
"""A script as uploaded by a client."""


class Line:
    """Connections to a robot without sockets: its clock advances only while a client waits for a sample."""

    def __init__(self, held: VirtualRobot) -> None:
        self.robot, self.others = held, list[Rtde]()
        self.cut, self.closed = False, False
        """No data passes in either direction; or both ends have a closed connection."""

    def __call__(self, host: str, port: int) -> Link:
        self.check()
        return Link(self, Rtde(self.robot, self.others) if port == PORT else None)

    def check(self) -> None:
        """Raise the error of a closed connection."""
        if self.closed:
            raise LostError("the robot has closed the connection")


class Link:
    """One connection: by RTDE, or one that accepts scripts."""

    def __init__(self, line: Line, rtde: Rtde | None) -> None:
        self.line, self.rtde = line, rtde

    def send(self, data: bytes) -> None:
        self.line.check()
        if self.line.cut:
            return
        if self.rtde is None:
            self.line.robot.run_program(Program(data.decode(), self.line.robot))
        else:
            assert self.rtde.received(data)

    def receive(self, patience: float) -> bytes:
        assert self.rtde is not None
        self.line.check()
        waiting = self.rtde.pending
        for _ in range(round(patience / self.line.robot.dt)):
            if waiting and not self.line.cut:
                break
            self.line.robot.advance()
        if self.line.cut:
            return b""
        data = bytes(waiting)
        waiting.clear()
        return data

    def close(self) -> None:
        if self.rtde is not None:
            self.rtde.close()


class Trace:
    """Record of the robot's motion, cycle by cycle."""

    def __init__(self, held: VirtualRobot) -> None:
        self.time, self.speed, self.commanded = list[float](), list[float](), list[float]()
        self.lost = 0
        held.listeners.append(self)

    def cycle(self, robot: VirtualRobot) -> None:
        self.time.append(robot.time)
        self.speed.append(float(np.abs(robot.dq).max()))
        self.commanded.append(float(np.abs(robot.target.qd).max()))
        self.lost += robot.sample_lost

    def rest(self, since: float) -> float:
        """Time from then until nothing moves [s]; inf if a joint still moves."""
        moves = [
            k for k, (v, target) in enumerate(zip(self.speed, self.commanded, strict=True)) if v > REST or target > 0
        ]
        first = moves[-1] + 1 if moves else 0
        return self.time[first] - since if first < len(self.time) else math.inf


REST = 0.01
"""Speed below which an arm is at rest [rad/s]: its servo's integral action removes the last error in seconds."""
