"""Virtual robots for tests, and a client of theirs that speaks bytes."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import cache
from typing import Any

import dmframe as dm
from dmframe.virtual import VirtualRobot
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


def runs(held: VirtualRobot, script: str, cycles: int = 2000) -> VirtualRobot:
    """Run a script to its end."""
    held.load_script(script)
    for _ in range(cycles):
        if not held.running:
            return held
        held.advance()
    raise AssertionError(f"still runs after {cycles} cycles: {list(held.messages)}")


def message(kind: str, payload: bytes = b"") -> bytes:
    """A message of RTDE, as its guide has it."""
    return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload


class Client:
    """One client by RTDE, without a socket."""

    def __init__(self, held: VirtualRobot, others: list[Rtde] | None = None) -> None:
        self.robot = held
        self.rtde = Rtde(held, [] if others is None else others)

    def told(self) -> list[tuple[str, bytes]]:
        """What has come: kinds and payloads."""
        data, found = bytes(self.rtde.pending), []
        self.rtde.pending.clear()
        while data:
            length, kind = struct.unpack(">HB", data[:3])
            found.append((chr(kind), data[3:length]))
            data = data[length:]
        return found

    def ask(self, kind: str, payload: bytes = b"") -> tuple[str, bytes]:
        """One message, and its answer."""
        self.rtde.received(message(kind, payload))
        (answer,) = self.told()
        return answer

    def begin(self, outputs: Sequence[str], inputs: Sequence[str] = (), frequency: float | None = None) -> None:
        """From the version to the first sample."""
        rate = 1 / self.robot.dt if frequency is None else frequency
        assert self.ask("V", b"\0\2") == ("V", b"\1")
        assert self.ask("O", struct.pack(">d", rate) + ",".join(outputs).encode())[1][0] == 1
        if inputs:
            assert self.ask("I", ",".join(inputs).encode())[1][0] == 1
        assert self.ask("S") == ("S", b"\1")

    def samples(self, form: str) -> list[tuple[Any, ...]]:
        """The samples that have come, as `struct` reads them."""
        return [struct.unpack(f">{form}", payload[1:]) for kind, payload in self.told() if kind == "U"]

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
"""Such as a client of its own uploads."""
