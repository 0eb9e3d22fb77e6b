"""Socket functions of scripts."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from typing import TYPE_CHECKING, Any, Final, TypeVar

from dmframe.virtual.arithmetic import is_number, text
from dmframe.virtual.sockets import Sockets
from dmframe.virtual.words import ScriptError

if TYPE_CHECKING:
    from dmframe.virtual.robot import VirtualRobot

MOST_NUMBERS: Final = 1000
"""Numbers or bytes that a script reads in one call."""
Waits = Generator[None, None, Any]
_F = TypeVar("_F", bound=Callable[..., Waits])


def waits(function: _F) -> _F:
    """Mark a function that takes time."""
    function.waits = True  # type: ignore[attr-defined]
    return function


class SocketFunctions:
    """Functions of a script that communicate with its client; `Functions` has the others."""

    def __init__(self, robot: VirtualRobot) -> None:
        self._sockets = Sockets(robot)

    @waits
    def socket_open(self, address: Any, port: Any, socket_name: Any = "socket_0") -> Waits:
        return self._sockets.open(str(address), int(port), str(socket_name))

    def socket_close(self, socket_name: Any = "socket_0") -> None:
        self._sockets.shut(str(socket_name))

    def socket_send_string(self, str: Any, socket_name: Any = "socket_0") -> bool:
        return self._sockets.send(socket_name, text(str).encode())

    def socket_send_line(self, str: Any, socket_name: Any = "socket_0") -> bool:
        return self._sockets.send(socket_name, f"{text(str)}\n".encode())

    def socket_send_int(self, value: Any, socket_name: Any = "socket_0") -> bool:
        return self._sockets.send(socket_name, int(value).to_bytes(4, "big", signed=True))

    def socket_send_byte(self, value: Any, socket_name: Any = "socket_0") -> bool:
        return self._sockets.send(socket_name, bytes([int(value)]))

    @waits
    def socket_read_binary_integer(self, number: Any, socket_name: Any = "socket_0", timeout: Any = 2) -> Waits:
        number = _count(number)
        data = yield from self._sockets.read(socket_name, 4 * number, timeout)
        found = [int.from_bytes(data[k : k + 4], "big", signed=True) for k in range(0, len(data), 4)]
        return [len(found), *found] if found else [0] + [-1] * number

    @waits
    def socket_read_byte_list(self, number: Any, socket_name: Any = "socket_0", timeout: Any = 2) -> Waits:
        number = _count(number)
        data = yield from self._sockets.read(socket_name, number, timeout)
        return [len(data), *data] if data else [0] + [-1] * number

    @waits
    def socket_read_ascii_float(self, number: Any, socket_name: Any = "socket_0", timeout: Any = 2) -> Waits:
        number = _count(number)
        data = yield from self._sockets.read_until(socket_name, b")", timeout)
        words = data.decode("ascii", "replace").strip().strip("()").split(",")
        try:
            found = [float(word) for word in words] if data else []
        except ValueError:
            found = []
        full = len(found) == number
        return [float(len(found)), *found] if full else [0.0] + [math.nan] * number

    @waits
    def socket_read_line(self, socket_name: Any = "socket_0", timeout: Any = 2) -> Waits:
        data = yield from self._sockets.read_until(socket_name, b"\n", timeout)
        return data.decode("utf-8", "replace").rstrip("\r\n")

    @waits
    def socket_read_string(self, socket_name: Any = "socket_0", *_: Any, timeout: Any = 2, **__: Any) -> Waits:
        data = yield from self._sockets.read_some(socket_name, timeout)
        return data.decode("utf-8", "replace")


def _count(number: Any) -> int:
    if not is_number(number) or not 0 <= number <= MOST_NUMBERS:
        raise ScriptError(f"expected a count from 0 to {MOST_NUMBERS}, found {number}")
    return int(number)
