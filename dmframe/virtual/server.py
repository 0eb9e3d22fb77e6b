"""The ports of a UR on this machine: sockets that never block, looked at between the cycles of the robot."""

from __future__ import annotations

import selectors
import socket
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Final, final

from dmframe.errors import OutputError, ValueFault
from dmframe.virtual import dashboard, primary
from dmframe.virtual.program import Program
from dmframe.virtual.rtde import Rtde
from dmframe.virtual.words import MOST_WORDS, Arriving, ScriptError

if TYPE_CHECKING:
    from dmframe.virtual.robot import VirtualRobot

MOST_WAITING: Final = 1 << 20
"""Bytes that a client may leave unread; samples that do not fit are left out."""
MOST_TEXT: Final = 1 << 18
"""Of scripts that are not yet complete, or that wait to be read; a client that sends more is disconnected."""
WORDS: Final = 20_000.0
"""Of a client's scripts that are read in a second of the robot's time: no cycle passes meanwhile, some 10 us a word."""
MOST_LINES: Final = 50
"""Of the dashboard that are answered at once; the next are in the next cycle."""
MOST_CLIENTS: Final = 64
"""Connections at once."""
STATES: Final = 10.0
"""State messages in a second, on the primary and secondary ports."""


@final
@dataclass(frozen=True)
class Ports:
    """Where a robot listens; 0 for any that is free."""

    rtde: int = 30004
    dashboard: int = 29999
    primary: int = 30001
    secondary: int = 30002
    realtime: int = 30003

    @classmethod
    def free(cls) -> Ports:
        """Any that are free."""
        return cls(0, 0, 0, 0, 0)


NAMES: Final = tuple(field.name for field in fields(Ports))
"""Of ports."""


class _Client(ABC):
    """What is done with a connection: bytes come in by `received`, and those in `pending` go out."""

    pending: bytearray

    @abstractmethod
    def received(self, data: bytes) -> bool:
        """Take what arrived; False where the connection is to be closed."""

    def cycle(self, robot: VirtualRobot) -> None:  # noqa: B027 - most do nothing
        """A cycle is over."""

    def closed(self) -> None:  # noqa: B027 - as above
        """The connection is gone."""


@final
class _RtdeClient(_Client):
    def __init__(self, robot: VirtualRobot, others: list[Rtde]) -> None:
        self._rtde = Rtde(robot, others)
        self.pending = self._rtde.pending

    def received(self, data: bytes) -> bool:
        return self._rtde.received(data)

    def closed(self) -> None:
        self._rtde.close()


@final
class _DashboardClient(_Client):
    def __init__(self, robot: VirtualRobot) -> None:
        self._robot, self._rest = robot, b""
        self.pending = bytearray(f"{dashboard.GREETING}\n".encode())

    def received(self, data: bytes) -> bool:
        self._rest += data
        *lines, self._rest = self._rest.split(b"\n", MOST_LINES)
        for line in lines:
            text = line.decode("utf-8", "replace")
            self.pending += f"{dashboard.answer(self._robot, text)}\n".encode()
            if text.strip().lower() == "quit":
                return False
        return len(self._rest) < MOST_TEXT

    def cycle(self, robot: VirtualRobot) -> None:
        if b"\n" in self._rest:
            self.received(b"")


@final
class _ScriptClient(_Client):
    """Scripts come in; states go out as `sent` makes them, every so many cycles."""

    def __init__(self, robot: VirtualRobot, sent: Callable[[VirtualRobot], bytes], every: int, first: bytes) -> None:
        self._robot, self._sent, self._every = robot, sent, every
        self._arriving, self.pending = Arriving(), bytearray(first)
        self._words, self._refill = float(MOST_WORDS), WORDS * robot.dt

    def received(self, data: bytes) -> bool:
        self._arriving.text += data.decode("utf-8", "replace")
        self._begin()
        if len(self._arriving.text) < MOST_TEXT:
            return True
        self._robot.tell(f"a client is disconnected: more than {MOST_TEXT} characters of it wait to be read")
        return False

    def _begin(self) -> None:
        """Begin the scripts that have arrived, while there are words left for them."""
        while self._words > 0 and (text := self._arriving.take()):
            try:
                program = Program(text, self._robot)
                self._words -= program.words
                self._robot.run_program(program)
            except ScriptError as fault:
                self._words -= min(MOST_WORDS, len(text))
                self._robot.end_program("a script that cannot be read takes its place")
                self._robot.tell(f"script: {fault.text}")

    def cycle(self, robot: VirtualRobot) -> None:
        self._words = min(MOST_WORDS, self._words + self._refill)
        self._begin()
        if robot.cycles % self._every == 0 and len(self.pending) < MOST_WAITING:
            self.pending += self._sent(robot)


@final
class Servers:
    """The open ports of a robot.

    Raises
    ------
    OutputError
        A port is taken, or the address is not this machine's.
    """

    def __init__(self, robot: VirtualRobot, host: str, ports: Ports) -> None:
        self._robot, self._selector = robot, selectors.DefaultSelector()
        self._clients = dict[socket.socket, _Client]()
        self._doors = dict[socket.socket, Callable[[], _Client]]()
        self._rtde = list[Rtde]()
        every = round(1 / (STATES * robot.dt))
        made: dict[str, Callable[[], _Client]] = {
            "rtde": lambda: _RtdeClient(robot, self._rtde),
            "dashboard": lambda: _DashboardClient(robot),
            "primary": lambda: _ScriptClient(robot, primary.state, every, primary.greeting(robot)),
            "secondary": lambda: _ScriptClient(robot, primary.state, every, b""),
            "realtime": lambda: _ScriptClient(robot, primary.real_time, 1, b""),
        }
        try:
            opened = {name: self._open(host, getattr(ports, name), name, client) for name, client in made.items()}
        except OutputError:
            self.close()
            raise
        self.ports = replace(ports, **opened)

    def _open(self, host: str, port: int, name: str, client: Callable[[], _Client]) -> int:
        if not 0 <= port <= 65535:
            raise ValueFault(f"{name}: expected a port from 0 to 65535, found {port}")
        door = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            door.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            door.bind((host, port))
            door.listen()
        except OSError as error:
            door.close()
            why = (error.strerror or str(error)).lower()
            raise OutputError(f"{name}: cannot listen at {host}:{port}: {why}; name another --host or port") from None
        door.setblocking(False)
        self._doors[door] = client
        self._selector.register(door, selectors.EVENT_READ)
        found: int = door.getsockname()[1]
        return found

    @property
    def owing(self) -> list[Rtde]:
        """The clients by RTDE that have a sample, and have not answered it."""
        return [client for client in self._rtde if client.owes]

    def poll(self, timeout: float = 0.0) -> None:
        """Take what has come, and send what waits; wait for it no longer than `timeout` [s]."""
        for key, events in self._selector.select(timeout):
            held = key.fileobj
            assert isinstance(held, socket.socket)
            if held in self._doors:
                self._accept(held)
            elif held in self._clients:
                if events & selectors.EVENT_READ:
                    self._receive(held)
                self._send(held)

    def _accept(self, door: socket.socket) -> None:
        try:
            made, _ = door.accept()
        except OSError:
            return
        if len(self._clients) >= MOST_CLIENTS:
            self._robot.tell(f"a client is refused: {MOST_CLIENTS} are connected")
            made.close()
            return
        made.setblocking(False)
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._clients[made] = self._doors[door]()
        self._selector.register(made, selectors.EVENT_READ)
        self._send(made)

    def _receive(self, held: socket.socket) -> None:
        client = self._clients[held]
        try:
            data = held.recv(1 << 16)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(held)
        elif not client.received(data):
            self._send(held)
            self._drop(held)

    def _send(self, held: socket.socket) -> None:
        client = self._clients.get(held)
        if client is None:
            return None
        if client.pending:
            try:
                del client.pending[: held.send(client.pending)]
            except BlockingIOError:
                pass
            except OSError:
                return self._drop(held)
        wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if client.pending else 0)
        if self._selector.get_key(held).events != wanted:
            self._selector.modify(held, wanted)
        return None

    def _drop(self, held: socket.socket) -> None:
        client = self._clients.pop(held, None)
        if client is not None:
            client.closed()
            self._selector.unregister(held)
            held.close()

    def cycle(self) -> None:
        """Send what this cycle brought."""
        for held, client in list(self._clients.items()):
            client.cycle(self._robot)
            if len(client.pending) > 2 * MOST_WAITING:  # it reads nothing, and holds back answers as well
                self._drop(held)
            else:
                self._send(held)

    def close(self) -> None:
        """Close everything."""
        for held in list(self._clients):
            self._drop(held)
        for door in self._doors:
            self._selector.unregister(door)
            door.close()
        self._doors.clear()
        self._selector.close()
