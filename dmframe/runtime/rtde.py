"""A client of RTDE, the real-time data exchange of Universal Robots, version 2 of its protocol.

Written from the maker's guide. It was tried on no robot.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Mapping
from typing import Any, Final, Protocol, final

from dmframe.errors import DriveError, LostError

PORT: Final = 30004
FORMATS: Final = {
    "DOUBLE": "d",
    "VECTOR6D": "6d",
    "UINT32": "I",
    "INT32": "i",
}
"""The types that are asked for here."""
_HEAD: Final = struct.Struct(">HB")


class Link(Protocol):
    """Bytes to a robot and back."""

    def send(self, data: bytes) -> None:
        """All of it."""

    def receive(self, patience: float) -> bytes:
        """What has come, after so many seconds at most; it may be nothing. Raises `LostError` where it is closed."""

    def close(self) -> None:
        """Let go."""


@final
class Wire:
    """A connection by TCP."""

    def __init__(self, host: str, port: int, patience: float = 2.0) -> None:
        self.name = f"{host}:{port}"
        try:
            self._socket = socket.create_connection((host, port), patience)
        except OSError as error:
            raise LostError(f"{self.name}: expected a robot, and nobody answers: {error.strerror or error}") from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, data: bytes) -> None:
        """See `Link`."""
        try:
            self._socket.settimeout(1.0)
            self._socket.sendall(data)
        except OSError as error:
            raise LostError(f"{self.name}: the connection is lost: {error.strerror or error}") from None

    def receive(self, patience: float) -> bytes:
        """See `Link`."""
        try:
            self._socket.settimeout(max(patience, 0.0))
            data = self._socket.recv(65536)
        except (TimeoutError, BlockingIOError):
            return b""
        except OSError as error:
            raise LostError(f"{self.name}: the connection is lost: {error.strerror or error}") from None
        if not data:
            raise LostError(f"{self.name}: the robot has closed the connection")
        return data

    def close(self) -> None:
        """See `Link`."""
        self._socket.close()


@final
class Rtde:
    """A session: what is asked for comes again and again, and what is written is taken as one.

    Parameters
    ----------
    outputs, inputs
        Names, each with the type that it must have.
    patience
        How long an answer may take [s].

    Raises
    ------
    DriveError
        The robot does not know a name, has another type for it, or another client writes it.
    LostError
        It does not answer.
    """

    def __init__(
        self,
        link: Link,
        frequency: float,
        outputs: Mapping[str, str],
        inputs: Mapping[str, str],
        patience: float = 2.0,
    ) -> None:
        self._link, self._buffer, self._patience = link, b"", patience
        if self._asked("V", struct.pack(">H", 2)) != b"\x01":
            raise DriveError("RTDE: expected a robot that speaks version 2 of the protocol, found one that does not")
        answer = self._asked("O", struct.pack(">d", frequency) + ",".join(outputs).encode())
        self._outputs, self._names = _recipe(answer, outputs), tuple(outputs)
        self._in, self._inputs = 0, struct.Struct(">")
        if inputs:
            answer = self._asked("I", ",".join(inputs).encode())
            self._inputs, self._in = _recipe(answer, inputs), answer[0]
        if self._asked("S") != b"\x01":
            raise DriveError("RTDE: expected samples, and the robot does not begin")

    def read(self, patience: float) -> Mapping[str, Any]:
        """The newest sample, after at most so many seconds. Raises `LostError` where none comes."""
        newest, until = self._waiting(), time.monotonic() + patience
        while newest is None:
            data = self._link.receive(patience)
            self._buffer += data
            newest = self._waiting()
            # what comes may be anything but samples, for ever
            if newest is None and (not data or time.monotonic() > until):
                raise LostError(f"no sample for {patience * 1e3:.0f} ms")
        self._buffer += self._link.receive(0.0)
        later = self._waiting()
        values = list(self._outputs.unpack((later or newest)[1:]))
        found = dict[str, Any]()
        for name, count in zip(self._names, _counts(self._outputs), strict=True):
            part, values = values[:count], values[count:]
            found[name] = part if count > 1 else part[0]
        return found

    def write(self, *values: float) -> None:
        """All inputs, in their order."""
        self._link.send(_message("U", bytes([self._in]) + self._inputs.pack(*values)))

    def close(self) -> None:
        """End the session."""
        self._link.close()

    def _waiting(self) -> bytes | None:
        """The newest whole sample of the buffer; those before it are dropped."""
        newest = None
        while (message := self._next()) is not None:
            if message[0] == "U" and len(message[1]) == 1 + self._outputs.size:
                newest = message[1]
        return newest

    def _next(self) -> tuple[str, bytes] | None:
        if len(self._buffer) < _HEAD.size:
            return None
        length, kind = _HEAD.unpack_from(self._buffer)
        if length < _HEAD.size:
            raise LostError("RTDE: what comes is not of this protocol")
        if len(self._buffer) < length:
            return None
        payload, self._buffer = self._buffer[_HEAD.size : length], self._buffer[length:]
        return chr(kind), payload

    def _asked(self, kind: str, payload: bytes = b"") -> bytes:
        self._link.send(_message(kind, payload))
        until = time.monotonic() + self._patience
        while True:
            while (message := self._next()) is not None:
                if message[0] == kind:
                    return message[1]
            data = self._link.receive(self._patience)
            if not data or time.monotonic() > until:
                raise LostError(f"RTDE: no answer for {self._patience:g} s")
            self._buffer += data


def _message(kind: str, payload: bytes) -> bytes:
    return _HEAD.pack(_HEAD.size + len(payload), ord(kind)) + payload


def _recipe(answer: bytes, names: Mapping[str, str]) -> struct.Struct:
    kinds = answer[1:].decode(errors="replace").split(",")
    taken = [name for name, kind in zip(names, kinds, strict=False) if kind == "IN_USE"]
    if taken:
        raise DriveError(
            f"RTDE: expected registers that no other client writes, found {taken[0]} and {len(taken) - 1} more in use; "
            "end the other client"
        )
    if len(kinds) != len(names):
        raise DriveError(f"RTDE: expected a robot that knows {len(names)} names, found {len(kinds)}")
    wrong = [f"{name}: {found}" for (name, kind), found in zip(names.items(), kinds, strict=True) if found != kind]
    if wrong:
        raise DriveError(f"RTDE: expected names and types of the maker's guide, found {', '.join(wrong)}")
    return struct.Struct(">" + "".join(FORMATS[kind] for kind in kinds))


def _counts(recipe: struct.Struct) -> list[int]:
    """Numbers of each item: 6d is one item of six."""
    found, repeat = list[int](), ""
    for letter in recipe.format[1:]:
        if letter.isdigit():
            repeat += letter
        else:
            found.append(int(repeat or 1))
            repeat = ""
    return found
