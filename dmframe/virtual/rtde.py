"""Server side of RTDE, UR's protocol for samples and inputs, version 2.

A message is its length (two bytes, which count the three of the header), its type (a letter) and its payload, in
network byte order.
"""

from __future__ import annotations

import struct
from collections import deque
from typing import TYPE_CHECKING, Final, final

from dmframe.virtual.registers import FORMATS, INPUTS, packed, size_of, type_of

if TYPE_CHECKING:
    from dmframe.virtual.robot import VirtualRobot

HEADER: Final = 3
MOST_RECIPES: Final = 255
OUTPUT_RECIPE: Final = 1
SLOWEST: Final = 1e-3
"""Smallest frequency of samples [Hz]; a smaller one, or none, is the frequency of the controller."""
MOST_NAMES: Final = 512
"""Names in the recipes of a client."""
MOST_OUTPUTS: Final = 2048
"""Outputs that all clients together receive in a cycle."""


@final
class Rtde:
    """Connection of one RTDE client.

    Parameters
    ----------
    robot
        Robot that the client reads and writes.
    others
        All clients, including this one: only one client may write an input.
    """

    def __init__(self, robot: VirtualRobot, others: list[Rtde]) -> None:
        self._robot, self._others = robot, others
        self._rest, self.pending = b"", bytearray()
        self._recipes: dict[int, list[str]] = {}
        self.claimed = set[str]()
        """Inputs that this client writes."""
        self.outputs = list[str]()
        self._every, self._since = 1, 0
        self._started, self._version = False, 1
        self._sent: deque[tuple[int, bytes]] = deque()
        self._answers, self._owes = False, False
        others.append(self)
        robot.listeners.append(self)

    @property
    def owes(self) -> bool:
        """True if the client, which has answered samples, has not written since the last one."""
        return self._owes

    def excuse(self) -> None:
        """Expect no answers until the client writes again."""
        self._answers = self._owes = False

    def close(self) -> None:
        """Remove the client."""
        self._others.remove(self)
        self._robot.listeners.remove(self)

    def received(self, data: bytes) -> bool:
        """Process received bytes; answers go to `pending`. False if they are not RTDE: disconnect the client."""
        self._rest, first = self._rest + data, 0
        while len(self._rest) >= first + HEADER:
            length, kind = struct.unpack_from(">HB", self._rest, first)
            if length < HEADER:
                return False
            if len(self._rest) < first + length:
                break
            self._answer(chr(kind), self._rest[first + HEADER : first + length])
            first += length
        self._rest = self._rest[first:]
        return True

    def _answer(self, kind: str, message: bytes) -> None:
        match kind:
            case "V" if len(message) == 2:
                (wanted,) = struct.unpack(">H", message)
                self._version = wanted if wanted in (1, 2) else self._version
                self._queue("V", bytes([wanted in (1, 2)]))
            case "v":
                self._queue("v", struct.pack(">4I", *self._robot.version))
            case "O":
                self._set_outputs(message)
            case "I":
                self._set_inputs(message)
            case "S":
                self._started, self._since = bool(self.outputs), 0
                self._queue("S", bytes([self._started]))
            case "P":
                self._started = False
                self.excuse()
                self._queue("P", b"\1")
            case "U":
                self._write(message)
            case "M":
                text = message[1 : 1 + message[0]].decode("utf-8", "replace") if message else ""
                self._robot.report(f"message of a client: {text}")
            case _:
                self._warn(f"unknown message {kind!r}")

    def _set_outputs(self, message: bytes) -> None:
        every = 1.0
        if self._version == 2:
            if len(message) < 8:
                return self._warn("outputs: expected a frequency and a list of names")
            (wanted,) = struct.unpack(">d", message[:8])
            message, every = message[8:], 1 / self._robot.dt / wanted if wanted >= SLOWEST else 1.0
        names = _names(message)
        taken = sum(len(other.outputs) for other in self._others if other is not self)
        if len(names) > min(MOST_NAMES, MOST_OUTPUTS - taken):
            self._warn(f"outputs: expected at most {MOST_NAMES} names, and {MOST_OUTPUTS} of all clients")
            names = []
        kinds = [type_of(name) or "NOT_FOUND" for name in names]
        self.outputs = names if "NOT_FOUND" not in kinds else []
        self._every = max(1, round(every))
        recipe = bytes([OUTPUT_RECIPE if self.outputs else 0]) if self._version == 2 else b""
        return self._queue("O", recipe + ",".join(kinds).encode())

    def _set_inputs(self, message: bytes) -> None:
        names = _names(message)
        if len(names) + sum(map(len, self._recipes.values())) > MOST_NAMES:
            self._warn(f"inputs: expected at most {MOST_NAMES} names in all recipes")
            names = []
        others = [other.claimed for other in self._others if other is not self]
        kinds = [
            "IN_USE" if any(name in theirs for theirs in others) else INPUTS.get(name, "NOT_FOUND") for name in names
        ]
        good = bool(names) and not {"IN_USE", "NOT_FOUND"} & set(kinds) and len(self._recipes) < MOST_RECIPES
        recipe = len(self._recipes) + 1 if good else 0
        if good:
            self._recipes[recipe] = names
            self.claimed.update(names)
        self._queue("I", bytes([recipe]) + ",".join(kinds).encode())

    def _write(self, message: bytes) -> None:
        names = self._recipes.get(message[0]) if message else None
        if names is None:
            return self._warn("data: expected the number of an input recipe")
        kinds = [INPUTS[name] for name in names]
        if len(message) != 1 + sum(map(size_of, kinds)):
            return self._warn(f"data: expected {1 + sum(map(size_of, kinds))} bytes for recipe {message[0]}")
        values, first = {}, 1
        for name, kind in zip(names, kinds, strict=True):
            found = struct.unpack_from(f">{FORMATS[kind]}", message, first)
            values[name] = list(found) if kind.startswith("VECTOR") else found[0]
            first += size_of(kind)
        self._answers, self._owes = True, False
        return self._robot.write(values)

    def cycle(self, robot: VirtualRobot) -> None:
        """Queue the sample of this cycle, or a delayed one."""
        if self._started and self.outputs:
            if self._since % self._every == 0 and not robot.sample_lost:
                sample = (bytes([OUTPUT_RECIPE]) if self._version == 2 else b"") + packed(self.outputs, robot)
                self._sent.append((robot.cycles + robot.measurement_delay, sample))
            self._since += 1
        while self._sent and self._sent[0][0] <= robot.cycles:
            self._queue("U", self._sent.popleft()[1])
            self._owes = self._answers

    def _warn(self, text: str) -> None:
        """Queue a text message of the level warning."""
        message, by = text.encode()[:255], b"RTDE"
        self._queue("M", bytes([len(message)]) + message + bytes([len(by)]) + by + b"\2")

    def _queue(self, kind: str, payload: bytes) -> None:
        self.pending += struct.pack(">HB", HEADER + len(payload), ord(kind)) + payload


def _names(message: bytes) -> list[str]:
    return [name for name in message.decode("ascii", "replace").split(",") if name]
