"""The ports of the robot, by sockets, on a clock that the test advances."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterator

import pytest
from virtual_robots import message, robot

from dmframe.common.errors import OutputError
from dmframe.virtual import Ports, VirtualRobot

HOST = "127.0.0.1"
OPEN: list[socket.socket] = []


class Connected:
    """A client's socket, read while the robot serves its own."""

    def __init__(self, held: VirtualRobot, port: int) -> None:
        self.held, self.socket = held, socket.create_connection((HOST, port))
        self.socket.setblocking(False)
        OPEN.append(self.socket)
        held.advance()

    def send(self, data: bytes) -> None:
        self.socket.sendall(data)

    def read(self, count: int) -> bytes:
        """So many bytes; the robot's cycles continue until they have arrived."""
        data = b""
        for _ in range(5000):
            try:
                data += self.socket.recv(count - len(data))
            except BlockingIOError:
                self.held.advance()
            if len(data) == count:
                return data
        raise AssertionError(f"expected {count} bytes, found {data!r}")

    def line(self) -> str:
        """Up to the end of a line."""
        data = b""
        while not data.endswith(b"\n"):
            data += self.read(1)
        return data.decode().strip()

    def request(self, text: str) -> str:
        """A line of the dashboard."""
        self.send(f"{text}\n".encode())
        return self.line()


@pytest.fixture
def held() -> Iterator[VirtualRobot]:
    with robot() as found:
        yield found
    while OPEN:
        OPEN.pop().close()


def until(held: VirtualRobot, text: str) -> None:
    for _ in range(5000):
        if any(text in message for message in held.messages):
            return
        held.advance()
    raise AssertionError(f"expected {text!r} in {list(held.messages)}")


def test_rtde_by_a_socket(held: VirtualRobot) -> None:
    client = Connected(held, held.listen(HOST, Ports.free()).rtde)
    client.send(message("V", b"\0\2") + message("O", struct.pack(">d", 500.0) + b"timestamp") + message("S"))
    assert client.read(4 + 10 + 4) == message("V", b"\1") + message("O", b"\1DOUBLE") + message("S", b"\1")
    first, second = (struct.unpack(">d", client.read(12)[4:])[0] for _ in range(2))
    assert second - first == pytest.approx(held.dt)
    client.socket.close()
    held.advance(3)
    assert held.listeners == []


def test_the_dashboard(held: VirtualRobot) -> None:
    client = Connected(held, held.listen(HOST, Ports.free()).dashboard)
    assert client.line() == "Connected: Universal Robots Dashboard Server"
    assert client.request("robotmode") == "Robotmode: RUNNING"
    assert client.request("PolyscopeVersion").startswith("URSoftware 5.11.0.108249")
    assert client.request("get robot model") == "UR10"
    assert client.request("get serial number").isdigit()
    assert client.request("programState") == "STOPPED virtual.urp"
    held.load_script("def p():\n while True:\n  sync()\n end\nend\n")
    assert client.request("running") == "Program running: true"
    assert client.request("stop") == "Stopped"
    assert not held.running
    held.protective_stop()
    assert client.request("safetystatus") == "Safetystatus: PROTECTIVE_STOP"
    assert client.request("unlock protective stop") == "Protective stop releasing"
    assert client.request("unlock protective stop") == "Cannot unlock protective stop"
    held.emergency_stop()
    assert client.request("safetymode") == "Safetymode: ROBOT_EMERGENCY_STOP"
    held.release_emergency_stop()
    assert client.request("robotmode") == "Robotmode: POWER_OFF"
    client.request("power on")
    assert client.request("robotmode") == "Robotmode: IDLE"
    client.request("brake release")
    assert client.request("robotmode") == "Robotmode: RUNNING"
    assert client.request("make coffee") == "could not understand: 'make coffee'"
    assert client.request("quit") == "Disconnected"


@pytest.mark.parametrize("name", ["primary", "secondary", "realtime"])
def test_a_script_by_each_port_that_takes_one(held: VirtualRobot, name: str) -> None:
    client = Connected(held, getattr(held.listen(HOST, Ports.free()), name))
    text = b'def p():\n textmsg("steptime ", get_steptime())\nend\n'
    client.send(text[:20])
    held.advance(2)
    assert not held.messages
    client.send(text[20:])
    until(held, "steptime 0.002")
    client.send(b"def p(:\nend\n")
    until(held, "script: line 1: expected ')', found :")


def test_the_primary_port_sends_version_mode_and_limits(held: VirtualRobot) -> None:
    client = Connected(held, held.listen(HOST, Ports.free()).primary)
    size, kind, _, source, about = struct.unpack(">IBQbB", client.read(15))
    text = client.read(size - 15)
    assert (kind, source, about) == (20, -2, 3)
    assert text[:10] == b"\x09URControl"
    assert struct.unpack(">BBii", text[10:20]) == (5, 11, 0, 108249)
    size, kind = struct.unpack(">IB", client.read(5))
    assert kind == 16
    body, found = client.read(size - 5), dict[int, bytes]()
    while body:
        length, part = struct.unpack(">IB", body[:5])
        found[part], body = body[5:length], body[length:]
    assert {0, 6} <= set(found)
    assert len(found[0]) + 5 == 47  # as long as the manufacturer's
    assert found[0][15] == 7
    assert len(found[6]) + 5 == 445
    assert struct.unpack(">4d", found[6][96:128])[::2] == (2.16, 2.16)


def test_the_real_time_port_sends_the_joints(held: VirtualRobot) -> None:
    client = Connected(held, held.listen(HOST, Ports.free()).realtime)
    (size,) = struct.unpack(">I", client.read(4))
    numbers = struct.unpack(f">{(size - 4) // 8}d", client.read(size - 4))
    assert size == 1108
    assert numbers[31:34] == pytest.approx((1.455411, -1.016031, 0.978316), abs=1e-5)


def test_a_script_opens_sockets_to_its_client(held: VirtualRobot) -> None:
    door = socket.create_server((HOST, 0))
    port = door.getsockname()[1]
    held.load_script(
        f"""def p():
  if socket_open("{HOST}", {port}, "back"):
    socket_send_line("hello", "back")
    socket_send_int(-7, "back")
    numbers = socket_read_binary_integer(2, "back", 1)
    floats = socket_read_ascii_float(2, "back", 1)
    text = socket_read_line("back", 1)
    none = socket_read_binary_integer(1, "back", 0.1)
    textmsg(numbers, floats)
    textmsg(text, none)
    socket_close("back")
  end
  textmsg("other ", socket_open("{HOST}", 1, "closed"))
end
"""
    )
    held.advance(2)
    back, _ = door.accept()
    held.advance(2)
    assert back.recv(100) == b"hello\n" + struct.pack(">i", -7)
    back.sendall(struct.pack(">ii", 3, -4) + b"(1.5,2.5)" + b"some words\n")
    until(held, "some words[0, -1]")
    assert any("[2, 3, -4][2, 1.5, 2.5]" in text for text in held.messages)
    until(held, "other False")
    back.close()
    door.close()


def test_a_used_port_is_reported_and_nothing_stays_open(held: VirtualRobot) -> None:
    with socket.create_server((HOST, 0)) as other:
        taken = other.getsockname()[1]
        with pytest.raises(OutputError, match=rf"realtime: cannot listen at {HOST}:{taken}: address already in use"):
            held.listen(HOST, Ports(0, 0, 0, 0, taken))
    ports = held.listen(HOST, Ports.free())
    held.close()
    for port in vars(ports).values():
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((HOST, port))


def test_a_client_that_talks_nonsense_is_dropped(held: VirtualRobot) -> None:
    client = Connected(held, held.listen(HOST, Ports.free()).rtde)
    client.send(b"\0\0\0\0")
    held.advance(2)
    assert held.listeners == []
    assert client.socket.recv(10) == b""


def following(held: VirtualRobot, monkeypatch: pytest.MonkeyPatch) -> tuple[Connected, list[float]]:
    """A client that has answered a sample, while a script runs; and a time that passes while the robot waits."""
    client, now = Connected(held, held.listen(HOST, Ports.free()).rtde), [0.0]
    client.send(message("V", b"\0\2") + message("O", struct.pack(">d", 500.0) + b"timestamp"))
    client.send(message("I", b"input_int_register_24") + message("S"))
    client.read(4 + 10 + 9 + 4)
    held.load_script("def p():\n while True:\n  sync()\n end\nend\n")
    client.send(message("U", b"\1\0\0\0\1"))
    held.advance(2)
    assert held.owing

    def wait(seconds: float) -> None:
        now[0] += seconds
        assert held._servers is not None
        held._servers.poll()

    monkeypatch.setattr(held, "wait", wait)
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return client, now


def test_in_step_the_clock_waits_for_the_answer_to_each_sample(
    held: VirtualRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    client, now = following(held, monkeypatch)
    begun, answers = held.cycles, [0]

    def wanted() -> bool:
        if now[0] >= 5.0 * (answers[0] + 1):  # it takes 5 s for each
            answers[0] += 1
            client.send(message("U", b"\1\0\0\0\1"))
        return answers[0] < 4 or bool(held.owing)

    held.serve(wanted, 60.0)
    assert held.cycles - begun == 3
    assert held.late == 0


def test_in_step_a_silent_client_is_waited_for_no_longer_than_that(
    held: VirtualRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    client, now = following(held, monkeypatch)
    begun = held.cycles
    held.serve(lambda: now[0] < 60.1, 60.0)
    assert held.cycles - begun == pytest.approx(50, abs=2)  # in real time after that
    assert held.messages[-1].endswith("a client has not answered for 60 s: the clock continues")
    client.send(message("U", b"\1\0\0\0\1"))
    held.advance(2)
    assert held.owing  # it is waited for again


def test_who_pauses_or_has_no_script_is_not_waited_for(held: VirtualRobot, monkeypatch: pytest.MonkeyPatch) -> None:
    client, _ = following(held, monkeypatch)
    held.end_program("enough")
    assert not held.owing
    held.load_script("def p():\n while True:\n  sync()\n end\nend\n")
    held.advance()
    assert held.owing
    client.send(message("P"))
    held.advance()
    assert not held.owing
