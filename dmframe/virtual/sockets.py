"""Sockets that a script opens to its client; they never block the robot's clock."""

from __future__ import annotations

import errno
import select
import socket
from collections.abc import Callable, Generator
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, final

from dmframe.virtual.words import ScriptError

if TYPE_CHECKING:
    from dmframe.virtual.robot import VirtualRobot

Read = Generator[None, None, bytes]
OPENING: Final = 2.0
"""Timeout of a connection [s]."""
MOST: Final = 16
"""Sockets of a script."""
MOST_WAITING: Final = 1 << 16
"""Received bytes that a script has not read."""


@final
class Sockets:
    """Sockets of one script by name; times are in the robot's clock."""

    def __init__(self, robot: VirtualRobot) -> None:
        self._robot = robot
        self._open = dict[str, socket.socket]()
        self._rest = dict[str, bytes]()

    def close(self) -> None:
        """Close all sockets."""
        for name in list(self._open):
            self.shut(name)

    def shut(self, name: str) -> None:
        """Close one socket, if it is open."""
        connection = self._open.pop(name, None)
        self._rest.pop(name, None)
        if connection is not None:
            connection.close()

    def open(self, host: str, port: int, name: str) -> Generator[None, None, bool]:
        """Connect; False after the timeout."""
        self.shut(name)
        if len(self._open) >= MOST:
            raise ScriptError(f"socket_open {name}: expected no more than {MOST} sockets")
        host = "127.0.0.1" if host == "localhost" else host
        try:
            socket.inet_pton(socket.AF_INET, host)
        except OSError:  # a slow name server would stop the robot's clock
            raise ScriptError(f"socket_open: expected an address such as 127.0.0.1, found {host[:40]!r}") from None
        made = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        made.setblocking(False)
        try:
            state = made.connect_ex((host, port))
        except (OSError, OverflowError):
            made.close()
            return False
        until = self._robot.time + OPENING
        while state in (errno.EINPROGRESS, errno.EALREADY):
            if select.select([], [made], [], 0)[1]:
                state = made.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            elif self._robot.time >= until:
                break
            else:
                yield
        if state != 0:
            made.close()
            return False
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._open[name], self._rest[name] = made, b""
        return True

    def send(self, name: Any, data: bytes) -> bool:
        """Send all bytes; False if that fails."""
        connection = self._open.get(str(name))
        if connection is None:
            return False
        try:
            return connection.send(data) == len(data)
        except OSError:
            return False

    def read(self, name: Any, count: int, timeout: Any) -> Read:
        """Read a number of bytes; none after the timeout."""
        return self._read(str(name), timeout, lambda rest: count if len(rest) >= count else 0)

    def read_until(self, name: Any, end: bytes, timeout: Any) -> Read:
        """Read up to and including `end`."""
        return self._read(str(name), timeout, lambda rest: rest.find(end) + len(end) if end in rest else 0)

    def read_some(self, name: Any, timeout: Any) -> Read:
        """Read the bytes that have arrived."""
        return self._read(str(name), timeout, len)

    def _read(self, name: str, timeout: Any, enough: Callable[[bytes], int]) -> Read:
        until = self._robot.time + float(timeout) if timeout > 0 else None
        while name in self._open:
            gone = self._receive(name)
            if (count := enough(self._rest[name])) > 0:
                found, self._rest[name] = self._rest[name][:count], self._rest[name][count:]
                return found
            if gone or (until is not None and self._robot.time >= until):
                break
            yield
        return b""

    def _receive(self, name: str) -> bool:
        """Receive bytes; True if the client has closed the connection."""
        with suppress(BlockingIOError):
            try:
                data = self._open[name].recv(65536)
            except ConnectionError:
                return True
            self._rest[name] += data
            if len(self._rest[name]) > MOST_WAITING:
                raise ScriptError(f"socket {name}: expected no more than {MOST_WAITING} unread bytes")
            return not data
        return False
