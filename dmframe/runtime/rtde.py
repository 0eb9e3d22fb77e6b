"""Client of RTDE, the real-time data exchange of Universal Robots, version 2.

Written from the maker's guide, and not tested on a robot.
"""

from __future__ import annotations

import re
import socket
import struct
import time
from collections.abc import Mapping
from typing import Any, Final, Protocol, final

from dmframe.common.errors import DriveError, LostError

PORT: Final = 30004
FORMATS: Final = {"DOUBLE": "d", "VECTOR6D": "6d", "UINT32": "I", "INT32": "i"}
"""`struct` formats of the types in use."""
_HEAD: Final = struct.Struct(">HB")


class Link(Protocol):
    """Byte stream to a robot."""

    def send(self, data: bytes) -> None:
        """Send all bytes."""

    def receive(self, patience: float) -> bytes:
        """Received bytes, possibly none after the timeout [s]. Raises `LostError` if the connection is closed."""

    def close(self) -> None:
        """Close the connection."""


@final
class Wire:
    """TCP connection."""

    def __init__(self, host: str, port: int) -> None:
        self.name = f"{host}:{port}"
        try:
            self._socket = socket.create_connection((host, port), timeout=2.0)
        except OSError as error:
            raise LostError(f"{self.name}: no robot answers: {error.strerror or error}") from None
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
    """RTDE session: reads the outputs periodically, and writes all inputs together.

    Parameters
    ----------
    outputs, inputs
        Names with their types.
    patience
        Timeout of an answer [s].

    Raises
    ------
    DriveError
        The robot does not have a name, or has another type for it, or another client writes it.
    LostError
        The robot does not answer.
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
        if self._request("V", struct.pack(">H", 2)) != b"\x01":
            raise DriveError("RTDE: expected version 2 of the protocol, which this robot does not support")
        answer = self._request("O", struct.pack(">d", frequency) + ",".join(outputs).encode())
        self._outputs, self._names = _recipe(answer, outputs), tuple(outputs)
        self._in, self._inputs = 0, struct.Struct(">")
        if inputs:
            answer = self._request("I", ",".join(inputs).encode())
            self._inputs, self._in = _recipe(answer, inputs), answer[0]
        if self._request("S") != b"\x01":
            raise DriveError("RTDE: the robot does not start to send samples")

    def read(self, patience: float) -> Mapping[str, Any]:
        """Wait for a sample and return the newest one. Raises `LostError` after the timeout [s]."""
        newest, until = self._waiting(), time.monotonic() + patience
        while newest is None:
            data = self._link.receive(patience)
            self._buffer += data
            newest = self._waiting()
            # other messages may arrive forever
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
        """Write all inputs, in their order."""
        self._link.send(_message("U", bytes([self._in]) + self._inputs.pack(*values)))

    def close(self) -> None:
        """End the session."""
        self._link.close()

    def _waiting(self) -> bytes | None:
        """Newest complete sample of the buffer; older ones are dropped."""
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
            raise LostError("RTDE: received bytes are not of this protocol")
        if len(self._buffer) < length:
            return None
        payload, self._buffer = self._buffer[_HEAD.size : length], self._buffer[length:]
        return chr(kind), payload

    def _request(self, kind: str, payload: bytes = b"") -> bytes:
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
            f"RTDE: another client writes {taken[0]} and {len(taken) - 1} more of the registers; end the other client"
        )
    if len(kinds) != len(names):
        raise DriveError(f"RTDE: expected an answer for {len(names)} names, found {len(kinds)}")
    wrong = [f"{name}: {found}" for (name, kind), found in zip(names.items(), kinds, strict=True) if found != kind]
    if wrong:
        raise DriveError(f"RTDE: expected names and types of the maker's guide, found {', '.join(wrong)}")
    return struct.Struct(">" + "".join(FORMATS[kind] for kind in kinds))


def _counts(recipe: struct.Struct) -> list[int]:
    """Size of each item: 6d is one item of six numbers."""
    return [int(count or 1) for count in re.findall(r"(\d*)[a-z]", recipe.format[1:], re.IGNORECASE)]
