"""TCP ports of a virtual UR: non-blocking sockets that are polled between the robot's cycles."""

from __future__ import annotations

import codecs
import selectors
import socket
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Final, final

from dmframe.common.errors import OutputError, ValueFault
from dmframe.virtual import dashboard, primary
from dmframe.virtual.budget import Budget
from dmframe.virtual.program import Program
from dmframe.virtual.rtde import Rtde
from dmframe.virtual.words import MOST_WORDS, ScriptBuffer, ScriptError

if TYPE_CHECKING:
    from dmframe.virtual.robot import VirtualRobot

MOST_WAITING: Final = 1 << 20
"""Bytes that a client may leave unread; further samples are dropped."""
MOST_TEXT: Final = 1 << 18
"""Characters of scripts that wait to be translated; a client that sends more is disconnected."""
WORDS: Final = 20_000.0
"""Words of scripts that are translated in a second of the robot's time; each delays it by about 10 us."""
ALL_WORDS: Final = 3 * MOST_WORDS
"""Words of scripts of all clients that are translated without a pause."""
LEAST_WORDS: Final = 200
"""Words that a script counts at least."""
MOST_BYTES: Final = 2048
"""Bytes of all clients that are read at once; the others wait in their sockets."""
MOST_LINES: Final = 50
"""Lines that the dashboard answers at once."""
MOST_CLIENTS: Final = 64
"""Simultaneous connections."""
STATES: Final = 10.0
"""Rate of state messages on the primary and secondary ports [Hz]."""


@final
@dataclass(frozen=True)
class Ports:
    """TCP ports of a robot; 0 for any free one."""

    rtde: int = 30004
    dashboard: int = 29999
    primary: int = 30001
    secondary: int = 30002
    realtime: int = 30003

    @classmethod
    def free(cls) -> Ports:
        """Any free ports."""
        return cls(0, 0, 0, 0, 0)


NAMES: Final = tuple(field.name for field in fields(Ports))
"""Names of the ports."""


class _Client(ABC):
    """Protocol of a connection: `received` processes incoming bytes, `pending` holds those to send."""

    pending: bytearray

    @abstractmethod
    def received(self, data: bytes) -> bool:
        """Process received bytes; False to close the connection."""

    def cycle(self, robot: VirtualRobot) -> bool:
        """Called at the end of each cycle; False to close the connection."""
        return True

    def ended(self) -> None:  # noqa: B027 - most do nothing
        """Called when the other side has sent its last byte, before the connection is closed."""

    def closed(self) -> None:  # noqa: B027 - as above
        """Called when the connection is closed."""


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
        *lines, self._rest = (self._rest + data).split(b"\n", MOST_LINES)
        for line in lines:
            text = line.decode("utf-8", "replace")
            self.pending += f"{dashboard.answer(self._robot, text)}\n".encode()
            if text.strip().lower() == "quit":
                return False
        return len(self._rest) < MOST_TEXT

    def cycle(self, robot: VirtualRobot) -> bool:
        return b"\n" not in self._rest or self.received(b"")


@final
class _ScriptClient(_Client):
    """Receives scripts, and sends `sent(robot)`, the same `name` for all clients, every `every` cycles.

    A script is translated while neither the words of this client nor those of all clients are used up.
    """

    def __init__(
        self,
        robot: VirtualRobot,
        name: str,
        sent: Callable[[VirtualRobot], bytes],
        every: int,
        first: bytes,
        words: Budget,
    ) -> None:
        self._robot, self._name, self._sent, self._every = robot, name, sent, every
        self._arriving, self.pending = ScriptBuffer(), bytearray(first)
        self._decoded = codecs.getincrementaldecoder("utf-8")("replace").decode  # a character may arrive in pieces
        self._words = (words, Budget(WORDS * robot.dt, MOST_WORDS, MOST_WORDS))

    def received(self, data: bytes) -> bool:
        self._arriving.text += self._decoded(data)
        if len(self._arriving.text) < MOST_TEXT:
            return True
        self._robot.report(f"client disconnected: more than {MOST_TEXT} characters of its scripts are unread")
        return False

    def ended(self) -> None:
        """Start what has arrived since the last cycle: a client may close its connection right after its script."""
        self._begin()
        if self._arriving.take():
            self._robot.report("client disconnected: its scripts exceed the words of a second, and the rest is lost")

    def _begin(self) -> None:
        """Start the scripts that have arrived, within the budgets of words."""
        while all(words.left > 0 for words in self._words) and (text := self._arriving.take()):
            try:
                program = Program(text, self._robot)
                count = program.words
                self._robot.run_program(program)
            except ScriptError as fault:
                count = min(MOST_WORDS, len(text))
                self._robot.end_program("an invalid script replaces it")
                self._robot.report(f"script: {fault.text}")
            for words in self._words:
                words.left -= max(LEAST_WORDS, count)

    def cycle(self, robot: VirtualRobot) -> bool:
        self._words[1].cycle()
        self._begin()
        if robot.cycles % self._every == 0 and len(self.pending) < MOST_WAITING:
            if self._name not in robot.encoded:
                robot.encoded[self._name] = self._sent(robot)
            self.pending += robot.encoded[self._name]
        return True


@final
class Servers:
    """Open ports of a robot.

    Raises
    ------
    OutputError
        A port is in use, or the address is not an address of this machine.
    """

    def __init__(self, robot: VirtualRobot, host: str, ports: Ports) -> None:
        self._robot, self._selector = robot, selectors.DefaultSelector()
        self._clients = dict[socket.socket, _Client]()
        self._doors = dict[socket.socket, Callable[[], _Client]]()
        self._rtde, self._words, self._served = list[Rtde](), Budget(WORDS * robot.dt, ALL_WORDS, ALL_WORDS), 0
        every = round(1 / (STATES * robot.dt))

        def scripts(name: str, sent: Callable[[VirtualRobot], bytes], every: int, first: bytes = b"") -> _Client:
            return _ScriptClient(robot, name, sent, every, first, self._words)

        made: dict[str, Callable[[], _Client]] = {
            "rtde": lambda: _RtdeClient(robot, self._rtde),
            "dashboard": lambda: _DashboardClient(robot),
            "primary": lambda: scripts("state", primary.state, every, primary.greeting(robot)),
            "secondary": lambda: scripts("state", primary.state, every),
            "realtime": lambda: scripts("real time", primary.real_time, 1),
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
        except (OSError, UnicodeError) as error:  # a name that no domain name can be
            door.close()
            why = (getattr(error, "strerror", None) or str(error)).lower()
            raise OutputError(f"{name}: cannot listen at {host}:{port}: {why}; choose another --host or port") from None
        door.setblocking(False)
        self._doors[door] = client
        self._selector.register(door, selectors.EVENT_READ)
        found: int = door.getsockname()[1]
        return found

    @property
    def owing(self) -> list[Rtde]:
        """RTDE clients that have not answered the last sample."""
        return [client for client in self._rtde if client.owes]

    def poll(self, timeout: float = 0.0) -> None:
        """Receive at most `MOST_BYTES`, the clients taking turns, and send; wait at most `timeout` [s] for a socket."""
        ready, left = self._selector.select(timeout), MOST_BYTES
        self._served = (self._served + 1) % max(1, len(ready))
        for key, events in ready[self._served :] + ready[: self._served]:
            connection = key.fileobj
            assert isinstance(connection, socket.socket)
            if connection in self._doors:
                self._accept(connection)
            elif connection in self._clients:
                if events & selectors.EVENT_READ and left > 0:
                    left -= self._receive(connection, left)
                self._send(connection)

    def _accept(self, door: socket.socket) -> None:
        try:
            made, _ = door.accept()
        except OSError:
            return
        if len(self._clients) >= MOST_CLIENTS:
            self._robot.report(f"client refused: {MOST_CLIENTS} are connected")
            made.close()
            return
        made.setblocking(False)
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._clients[made] = self._doors[door]()
        self._selector.register(made, selectors.EVENT_READ)
        self._send(made)

    def _receive(self, connection: socket.socket, most: int) -> int:
        """Receive at most some bytes, and return their number."""
        client = self._clients[connection]
        try:
            data = connection.recv(most)
        except BlockingIOError:
            return 0
        except OSError:
            data = b""
        if not data:
            client.ended()
            self._drop(connection)
        elif not client.received(data):
            self._send(connection)
            self._drop(connection)
        return len(data)

    def _send(self, connection: socket.socket) -> None:
        client = self._clients.get(connection)
        if client is None:
            return None
        if client.pending:
            try:
                del client.pending[: connection.send(client.pending)]
            except BlockingIOError:
                pass
            except OSError:
                return self._drop(connection)
        wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if client.pending else 0)
        if self._selector.get_key(connection).events != wanted:
            self._selector.modify(connection, wanted)
        return None

    def _drop(self, connection: socket.socket) -> None:
        client = self._clients.pop(connection, None)
        if client is not None:
            client.closed()
            self._selector.unregister(connection)
            connection.close()

    def cycle(self) -> None:
        """Update all clients at the end of a cycle, and send their messages."""
        self._words.cycle()
        clients = list(self._clients.items())
        first = self._robot.cycles % max(1, len(clients))  # the clients take turns
        for connection, client in clients[first:] + clients[:first]:
            continues = client.cycle(self._robot)
            if not continues or len(client.pending) > 2 * MOST_WAITING:  # it does not read its answers either
                self._send(connection)
                self._drop(connection)
            else:
                self._send(connection)

    def close(self) -> None:
        """Close all connections and ports."""
        for connection in list(self._clients):
            self._drop(connection)
        for door in self._doors:
            self._selector.unregister(door)
            door.close()
        self._doors.clear()
        self._selector.close()
