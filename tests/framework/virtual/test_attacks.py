"""No client stops the robot for the others: the work per cycle is bounded for any input, and is shared.

Work is measured in function calls, which do not depend on the machine.
"""

from __future__ import annotations

import socket
import struct
import sys
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest
from script_attacks import ATTACKS
from virtual_robots import Client, message, robot

from dmframe.common.errors import OutputError
from dmframe.virtual import VirtualRobot
from dmframe.virtual.budget import BURSTS, LEAST_BURST
from dmframe.virtual.rtde import MOST_NAMES, MOST_OUTPUTS
from dmframe.virtual.server import MOST_WAITING, Ports

MOST = 150_000
"""Calls per cycle: some tens of milliseconds."""
CLIENTS = 40
VERSION = message("V", b"\0\2")
ROBOTS: list[VirtualRobot] = []
SOCKETS: list[socket.socket] = []


@pytest.fixture
def held() -> Iterator[VirtualRobot]:
    if not ROBOTS:
        ROBOTS.append(robot("ur10_full"))
    found = ROBOTS[0]
    found.end_program("another test")
    yield found
    while SOCKETS:
        SOCKETS.pop().close()
    found.close()


def connected(held: VirtualRobot, port: int, count: int = CLIENTS) -> list[socket.socket]:
    made = [socket.create_connection(("127.0.0.1", port), timeout=10) for _ in range(count)]
    for each in made:
        each.setblocking(False)
        each.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        held.advance(2)
    SOCKETS.extend(made)
    return made


def pushed(client: socket.socket, data: bytes) -> int:
    """Send as much as the socket accepts."""
    try:
        return client.send(data)
    except BlockingIOError:
        return 0


def drained(client: socket.socket) -> None:
    """Read what has arrived."""
    with suppress(BlockingIOError):
        while client.recv(1 << 20):
            pass


def work(held: VirtualRobot, cycles: int = 1) -> int:
    """Largest number of calls in one of these cycles."""
    most = calls = 0

    def noted(frame: Any, event: str, what: Any) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")

    for _ in range(cycles):
        calls = 0
        sys.setprofile(noted)
        try:
            held.advance()
        finally:
            sys.setprofile(None)
        most = max(most, calls)
    return most


@pytest.mark.parametrize("name", ATTACKS)
def test_a_script_works_within_its_cycle(held: VirtualRobot, name: str) -> None:
    (client,) = connected(held, held.listen(ports=Ports.free()).secondary, 1)
    script, sent, most = ATTACKS[name][0].encode(), 0, 0
    for _ in range(200):
        sent += pushed(client, script[sent : sent + 4096])
        most = max(most, work(held))
    assert most < 4 * MOST  # the longest script is translated at once


def test_a_flood_of_messages_does_not_fill_a_cycle(held: VirtualRobot) -> None:
    clients = connected(held, held.listen(ports=Ports.free()).rtde)
    for _ in range(5):
        for client in clients:
            pushed(client, message("v") * 5000)
        assert work(held) < MOST / 10


def test_a_client_is_read_while_others_flood_the_robot(held: VirtualRobot) -> None:
    ports = held.listen(ports=Ports.free())
    floods, (one,) = connected(held, ports.rtde), connected(held, ports.rtde, 1)
    for client in floods:
        pushed(client, message("v") * 20_000)
    one.send(VERSION)
    held.advance(2 * CLIENTS)
    assert one.recv(4) == message("V", b"\1")


def test_outputs_are_computed_once_for_all_clients_and_are_limited(held: VirtualRobot) -> None:
    clients = connected(held, held.listen(ports=Ports.free()).rtde)
    names = ",".join(["actual_TCP_speed"] * MOST_NAMES).encode()
    for client in clients:
        pushed(client, VERSION + message("O", struct.pack(">d", 500.0) + names) + message("S"))
    for _ in range(12 * CLIENTS):
        held.advance()
        for client in clients:
            drained(client)
    assert work(held, 3) < MOST / 10
    assert held._servers is not None
    assert sum(len(client.outputs) for client in held._servers._rtde) == MOST_OUTPUTS


@pytest.mark.parametrize("name", ["primary", "secondary", "realtime"])
def test_a_message_for_all_clients_is_made_once(held: VirtualRobot, name: str) -> None:
    port = getattr(held.listen(ports=Ports.free()), name)
    connected(held, port, 1)
    one = work(held, 60)
    connected(held, port, CLIENTS - 1)
    assert work(held, 60) < one + 40 * CLIENTS


def test_scripts_of_many_clients_share_a_budget(held: VirtualRobot) -> None:
    clients = connected(held, held.listen(ports=Ports.free()).secondary)
    text = b"x = " + b"+".join([b"1"] * 4000) + b"\n"
    for client in clients:
        pushed(client, text)
    begun = held.message_count
    held.advance(400)  # all have arrived
    seconds = 400 * held.dt
    assert 5 <= sum("script begins" in m for m in list(held.messages)[begun - held.message_count :]) < 8 + 3 * seconds


def test_clients_that_come_again_have_no_new_budget(held: VirtualRobot) -> None:
    ports, begun = held.listen(ports=Ports.free()), held.message_count
    for _ in range(60):
        (client,) = connected(held, ports.secondary, 1)
        client.send(b"x = " + b"+".join([b"1"] * 900) + b"\n")
        held.advance(2)
        client.close()
    words = 1800 * sum("script begins" in m for m in list(held.messages)[begun - held.message_count :])
    assert words < 60_000 + 2 * 1800 + 20_000 * 60 * 4 * held.dt


def test_programs_in_close_succession_share_their_first_operations() -> None:
    held = robot()
    found = [held.bursts.drawn() for _ in range(10)]
    assert sum(found[:4]) == BURSTS
    assert found[4:] == [LEAST_BURST] * 6
    held.advance(100)
    assert held.bursts.drawn() > LEAST_BURST


@pytest.mark.parametrize("rate", [5e-324, 1e-310, 1e308, float("inf"), float("nan"), -1.0, 0.0])
def test_any_frequency_is_one(rate: float) -> None:
    held = robot()
    client = Client(held)
    assert client.request("V", b"\0\2") == ("V", b"\1")
    assert client.request("O", struct.pack(">d", rate) + b"timestamp")[1] == b"\1DOUBLE"
    client.request("S")
    held.advance(3)
    assert len(client.samples("d")) == 3


def test_names_of_inputs_are_limited() -> None:
    held = robot()
    client = Client(held)
    names = ",".join(f"input_int_register_{k % 48}" for k in range(300)).encode()
    assert client.request("I", names)[1][0] == 1
    client.rtde.received(message("I", names))
    (warning, (kind, answer)) = client.received()
    assert warning[0] == "M"
    assert b"expected at most 512 names" in warning[1]
    assert (kind, answer[0]) == ("I", 0)
    assert len(client.rtde.claimed) == 48


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_registers_of_no_numbers_reach_scripts_and_clients_and_stop_nothing(value: float) -> None:
    held = robot()
    client = Client(held)
    names = ["input_double_register_24", "speed_slider_mask", "speed_slider_fraction"]
    client.begin(["input_double_register_24", "target_speed_fraction"], names)
    client.write("dId", value, 1, value)
    held.load_script(
        "def p():\n  while True:\n    speedj([read_input_float_register(24), 0, 0, 0, 0, 0], 1, 0.1)\n  end\nend\n"
    )
    held.advance(20)
    assert struct.pack(">d", client.samples("dd")[-1][0]) == struct.pack(">d", value)
    assert held.slider == 1.0
    assert "protective stop" in " ".join(held.messages)
    assert abs(held.dq).max() < 0.1


def test_a_half_closed_connection_frees_what_it_had(held: VirtualRobot) -> None:
    ports = held.listen(ports=Ports.free())
    (client,) = connected(held, ports.rtde, 1)
    client.send(VERSION + message("I", b"input_int_register_24") + message("O", bytes(8) + b"timestamp") + message("S"))
    held.advance(3)
    assert len(held.listeners) == 1
    client.shutdown(socket.SHUT_WR)
    held.advance(3)
    assert held.listeners == []
    (again,) = connected(held, ports.rtde, 1)
    again.send(message("I", b"input_int_register_24"))
    held.advance(3)
    assert again.recv(100) == message("I", b"\1INT32")


def test_a_client_that_reads_nothing_is_dropped(held: VirtualRobot) -> None:
    (client,) = connected(held, held.listen(ports=Ports.free()).rtde, 1)
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    names = ",".join(["actual_TCP_speed"] * MOST_NAMES).encode()
    pushed(client, VERSION + message("O", struct.pack(">d", 500.0) + names) + message("S"))
    held.advance(2 * MOST_WAITING // (MOST_NAMES * 48) + 400)
    assert held.listeners == []


def test_a_script_arrives_in_any_pieces(held: VirtualRobot) -> None:
    (client,) = connected(held, held.listen(ports=Ports.free()).secondary, 1)
    for byte in 'textmsg("Grüße, 你好")\n'.encode():
        client.send(bytes([byte]))
        held.advance()
    held.advance(3)
    assert "Grüße, 你好" in " ".join(held.messages)


def test_a_script_runs_whose_client_closes_its_connection_within_the_cycle(held: VirtualRobot) -> None:
    servers = held.listen(ports=Ports.free())
    (client,) = connected(held, servers.secondary, 1)
    client.send(b'textmsg("sent and closed")\n')
    client.close()
    for _ in range(3):  # while a robot waits for a sample's answer, it polls several times in a cycle
        held.wait(0.1)
    held.advance()
    assert "sent and closed" in " ".join(held.messages)


@pytest.mark.parametrize("host", ["a" * 70, "..", "no host", "300.1.1.1"])
def test_an_address_that_is_invalid_is_reported(host: str) -> None:
    held = robot()
    with pytest.raises(OutputError, match="choose another --host or port"):
        held.listen(host, Ports.free())
