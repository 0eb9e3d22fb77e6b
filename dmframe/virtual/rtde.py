"""RTDE, the maker's protocol for samples and inputs, version 2: what arrives and what is answered, in bytes.

A message is its length (two bytes, the header's three among them), its type, a letter, and what that type holds;
numbers in the network's order.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from typing import TYPE_CHECKING, Final, final

from dmframe.virtual.registers import FORMATS, INPUTS, packed, size_of, type_of

if TYPE_CHECKING:
    from dmframe.virtual.robot import VirtualRobot

HEADER: Final = 3
MOST_RECIPES: Final = 255
OUTPUT_RECIPE: Final = 1
MOST_NAMES: Final = 512
"""Of a recipe: each is computed anew in each cycle."""


@final
class Rtde:
    """One client.

    Parameters
    ----------
    robot
        Whose samples it gets; what it writes goes there.
    others
        All clients, this one among them: an input belongs to one alone.
    """

    def __init__(self, robot: VirtualRobot, others: list[Rtde]) -> None:
        self._robot, self._others = robot, others
        self._rest, self.pending = b"", bytearray()
        self._recipes: dict[int, list[str]] = {}
        self._outputs: list[str] | None = None
        self._every, self._since = 1, 0
        self._started, self._version = False, 1
        self._sent: deque[tuple[int, bytes]] = deque()
        self._answers, self._owes = False, False
        others.append(self)
        robot.listeners.append(self)

    @property
    def claimed(self) -> set[str]:
        """The inputs that are this client's."""
        return {name for names in self._recipes.values() for name in names}

    @property
    def owes(self) -> bool:
        """True where it has a sample, and has not written since; it has answered one before."""
        return self._owes

    def excuse(self) -> None:
        """Expect no answers from it, until it writes again."""
        self._answers = self._owes = False

    def close(self) -> None:
        """The client has gone."""
        self._others.remove(self)
        self._robot.listeners.remove(self)

    def received(self, data: bytes) -> bool:
        """Take what arrived; answers are left in `pending`. False where it is no RTDE: the client is to be dropped."""
        self._rest += data
        while len(self._rest) >= HEADER:
            length, kind = struct.unpack(">HB", self._rest[:HEADER])
            if length < HEADER:
                return False
            if len(self._rest) < length:
                return True
            message, self._rest = self._rest[HEADER:length], self._rest[length:]
            self._answer(chr(kind), message)
        return True

    def _answer(self, kind: str, message: bytes) -> None:
        match kind:
            case "V" if len(message) == 2:
                (asked,) = struct.unpack(">H", message)
                self._version = asked if asked in (1, 2) else self._version
                self._say("V", bytes([asked in (1, 2)]))
            case "v":
                self._say("v", struct.pack(">4I", *self._robot.version))
            case "O":
                self._set_outputs(message)
            case "I":
                self._set_inputs(message)
            case "S":
                self._started, self._since = self._outputs is not None, 0
                self._say("S", bytes([self._started]))
            case "P":
                self._started = False
                self.excuse()
                self._say("P", b"\1")
            case "U":
                self._write(message)
            case "M":
                self._robot.tell(
                    f"a client says: {message[1 : 1 + message[0]].decode('utf-8', 'replace')}" if message else ""
                )
            case _:
                self._tell(f"unknown message {kind!r}")

    def _set_outputs(self, message: bytes) -> None:
        rate = 1 / self._robot.dt
        if self._version == 2:
            if len(message) < 8:
                return self._tell("outputs: expected a frequency and names")
            (asked,) = struct.unpack(">d", message[:8])
            message, rate = message[8:], asked if math.isfinite(asked) and asked > 0 else rate
        names = _names(message)
        kinds = [type_of(name) or "NOT_FOUND" for name in names]
        found = bool(names) and "NOT_FOUND" not in kinds
        self._outputs = names if found else None
        self._every = max(1, round(1 / (rate * self._robot.dt)))
        recipe = bytes([OUTPUT_RECIPE if found else 0]) if self._version == 2 else b""
        return self._say("O", recipe + ",".join(kinds).encode())

    def _set_inputs(self, message: bytes) -> None:
        names = _names(message)
        theirs = {name for other in self._others if other is not self for name in other.claimed}
        kinds = ["IN_USE" if name in theirs else INPUTS.get(name, "NOT_FOUND") for name in names]
        good = bool(names) and not {"IN_USE", "NOT_FOUND"} & set(kinds) and len(self._recipes) < MOST_RECIPES
        recipe = len(self._recipes) + 1 if good else 0
        if good:
            self._recipes[recipe] = names
        self._say("I", bytes([recipe]) + ",".join(kinds).encode())

    def _write(self, message: bytes) -> None:
        names = self._recipes.get(message[0]) if message else None
        if names is None:
            return self._tell("data: expected the number of a recipe of inputs")
        kinds = [INPUTS[name] for name in names]
        if len(message) != 1 + sum(map(size_of, kinds)):
            return self._tell(f"data: expected {1 + sum(map(size_of, kinds))} bytes for recipe {message[0]}")
        values, first = {}, 1
        for name, kind in zip(names, kinds, strict=True):
            found = struct.unpack_from(f">{FORMATS[kind]}", message, first)
            values[name] = list(found) if kind.startswith("VECTOR") else found[0]
            first += size_of(kind)
        self._answers, self._owes = True, False
        return self._robot.write(values)

    def cycle(self, robot: VirtualRobot) -> None:
        """Send the sample of this cycle, or an older one."""
        if self._started and self._outputs is not None:
            if self._since % self._every == 0 and not robot.sample_lost:
                sample = (bytes([OUTPUT_RECIPE]) if self._version == 2 else b"") + packed(self._outputs, robot)
                self._sent.append((robot.cycles + robot.measurement_delay, sample))
            self._since += 1
        while self._sent and self._sent[0][0] <= robot.cycles:
            self._say("U", self._sent.popleft()[1])
            self._owes = self._answers

    def _tell(self, text: str) -> None:
        """A text message, a warning."""
        said, by = text.encode()[:255], b"RTDE"
        self._say("M", bytes([len(said)]) + said + bytes([len(by)]) + by + b"\2")

    def _say(self, kind: str, payload: bytes) -> None:
        self.pending += struct.pack(">HB", HEADER + len(payload), ord(kind)) + payload


def _names(message: bytes) -> list[str]:
    names = [name for name in message.decode("ascii", "replace").split(",") if name]
    return names if len(names) <= MOST_NAMES else [f"of more than {MOST_NAMES} names"]
