"""A script cannot stop the robot for others: each attack ends by itself, and another client gets each sample."""

from __future__ import annotations

import math
import resource
import socket
import struct
from collections.abc import Iterator

import pytest
from script_attacks import ATTACKS
from virtual_robots import FOLLOW, Client, message, robot, runs

from dmframe.virtual import ScriptError, VirtualRobot
from dmframe.virtual.budget import BURST, MOST_SECONDARY
from dmframe.virtual.server import MOST_CLIENTS, Ports
from dmframe.virtual.words import MOST_WORDS, ScriptBuffer

CYCLES = 400
SHARED: list[VirtualRobot] = []
OPENED: list[VirtualRobot] = []


def served() -> VirtualRobot:
    if not SHARED:
        SHARED.append(robot("ur10_full"))
    SHARED[0].end_program("another test")
    return SHARED[0]


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    yield
    for held in OPENED:
        held.close()
    OPENED.clear()


def listening(held: VirtualRobot) -> Ports:
    OPENED.append(held)
    return held.listen(ports=Ports.free())


def connected(held: VirtualRobot, port: int) -> socket.socket:
    made = socket.create_connection(("127.0.0.1", port), timeout=10)
    held.advance()
    return made


def samples(held: VirtualRobot, client: socket.socket, cycles: int) -> int:
    """Number of samples that arrive in so many cycles; the socket's buffer stores them all."""
    held.advance(cycles)
    client.setblocking(False)
    found = bytearray()
    try:
        while data := client.recv(1 << 16):
            found += data
    except BlockingIOError:
        pass
    client.setblocking(True)
    return found.count(struct.pack(">HB", 12, ord("U")))


@pytest.mark.parametrize("name", ATTACKS)
def test_an_attack_ends_by_itself_and_another_client_gets_each_sample(name: str) -> None:
    script, why = ATTACKS[name]
    held = served()
    ports = listening(held)
    with connected(held, ports.rtde) as watcher, connected(held, ports.secondary) as attacker:
        begin = message("V", b"\0\2") + message("O", struct.pack(">d", 500.0) + b"timestamp") + message("S")
        watcher.sendall(begin)
        samples(held, watcher, 3)
        before_attack = held.message_count
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        attacker.sendall(script.encode())
        assert samples(held, watcher, CYCLES) == CYCLES
        for _ in range(40):
            if not held.running:
                break
            assert samples(held, watcher, CYCLES) == CYCLES
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before  # [kB]
        messages = list(held.messages)[-(held.message_count - before_attack) :]
    assert any(why in text for text in messages), messages
    assert grown < 100_000


def test_a_fault_of_one_script_leaves_the_others_running() -> None:
    held = served()
    held.load_script("sec other():\n  sleep(0.6)\n  set_digital_out(2, True)\nend\n")
    held.load_script("sec attack():\n  x = [1]\n  while True:\n    x = [x, x]\n  end\nend\n")
    held.load_script(FOLLOW)
    held.advance(2)
    assert "attack ends: line 4: expected a value of no more than" in " ".join(list(held.messages)[-3:])
    assert held.running
    held.advance(310)
    assert held.digital_outputs == 4
    held.set_outputs(4, 0)


def test_secondary_scripts_are_limited() -> None:
    held = robot()
    for _ in range(MOST_SECONDARY + 3):
        held.load_script("sec other():\n  sleep(1)\nend\n")
    assert len(held.secondary) == MOST_SECONDARY
    assert f"not started: {MOST_SECONDARY} secondary programs are running" in held.messages[-1]


def test_what_a_script_may_do_it_does() -> None:
    """Well within the budgets: matrices, texts, recursion, a computation of one cycle."""
    script = """def fair():
  m = [[0, 0, 0], [0, 0, 0], [0, 0, 0]]
  k = 0
  while k < 9:
    m[floor(k / 3), k % 3] = k
    m[floor(k / 3)][k % 3] = m[floor(k / 3), k % 3] + 1
    k = k + 1
  end
  def change(given):
    given[0] = 99
    return given[0]
  end
  x = [1, 2]
  found = change(x)
  t = ""
  k = 0
  while k < 1000:
    t = str_cat(t, "a")
    k = k + 1
  end
  write_output_float_register(0, m[2, 2] + 100 * x[0] + 1000 * str_len(t) + found / 100)
  write_output_float_register(1, 1 - 2 + 3 * 4 / 6 % 4 - -5)
  write_output_boolean_register(0, True xor False xor True or 1 < 2 and not False)
end
"""
    held = served()
    ended = runs(held, script)
    assert "its last line is done" in ended.messages[-1], ended.messages[-1]
    assert ended.registers.values["output_double_register_0"] == pytest.approx(9 + 100 + 1e6 + 0.99)
    assert ended.registers.values["output_double_register_1"] == pytest.approx(1 - 2 + 2 + 5)
    assert ended.registers.values["output_bit_register_0"] is True


def test_a_singular_inverse_is_nan_and_the_script_continues() -> None:
    held = robot("ur10_fast")  # three of its joints are fixed
    script = """def inverse():
  q = get_inverse_kin(p[0.1, 0.6, 0.5, 0, 0, 0])
  write_output_float_register(0, q[0])
  write_output_boolean_register(1, get_inverse_kin_has_solution(p[0.1, 0.6, 0.5, 0, 0, 0]))
  write_output_float_register(1, force())
  write_output_integer_register(0, 7)
end
"""
    ended = runs(held, script)
    assert math.isnan(ended.registers.values["output_double_register_0"])
    assert math.isnan(ended.registers.values["output_double_register_1"])
    assert ended.registers.values["output_bit_register_1"] is False
    assert ended.registers.values["output_int_register_0"] == 7
    reported = " ".join(ended.messages)
    assert "inverse: inverse kinematics: ur10 has only 3 free joints in this graph; the result is NaN" in reported


def test_torques_are_k_u_at_every_place_where_a_client_reads_them() -> None:
    held = robot("ur10_fast")
    client = Client(held)
    client.begin(["target_moment", "actual_current_as_torque"])
    script = "def inverse():\n  t = get_joint_torques()\n  write_output_float_register(3, t[1])\nend\n"
    held.advance(3)
    runs(held, script)
    *_, last = client.samples("6d6d")
    # at rest the motors compensate gravity, as Pinocchio computes
    import pinocchio as pin

    chain = held.arm.chain
    data = chain.model.createData()
    gravity = pin.computeGeneralizedGravity(chain.model, data, held.arm._configuration(held.q))
    assert last[:3] == pytest.approx(gravity, abs=0.5)
    assert abs(gravity[1]) > 20
    assert last[3:6] == (0.0, 0.0, 0.0)
    assert last[6:] == last[:6]
    assert held.registers.values["output_double_register_3"] == pytest.approx(last[1], abs=0.1)


def test_a_line_that_leaves_the_workspace_ends_its_script_and_the_robot_goes_on() -> None:
    held = robot("ur10_full")
    x, y, z = held.arm.pose(held.q)[:3]
    turn = ", ".join(map(str, held.arm.pose(held.q)[3:]))
    held.load_script(f"def far():\n  movel(p[{x}, {y}, {z + 9}, {turn}], a=5, v=3)\nend\n")
    for _ in range(3000):
        if not held.running:
            break
        held.advance()
    assert not held.running
    held.advance(500)
    assert held.target.still


def test_a_client_that_sends_too_many_words_waits_and_others_do_not() -> None:
    held = robot()
    ports = listening(held)
    line = "x = " + "+".join(["1"] * 4000) + "\n"
    with connected(held, ports.secondary) as many, connected(held, ports.primary) as one:
        many.sendall(8 * line.encode())
        held.advance(3)
        begun = sum("script begins" in text for text in held.messages)
        assert begun <= math.ceil(MOST_WORDS / 8000)
        one.sendall(b"set_digital_out(1, True)\n")
        held.advance(3)
        assert held.digital_outputs == 2
        held.advance(2000)
        assert sum("script begins" in text for text in held.messages) == 9


def test_a_text_without_end_is_cut_off() -> None:
    held = robot()
    ports = listening(held)
    with connected(held, ports.secondary) as client:
        for _ in range(5):
            client.sendall(b"def a():\n" + b"  x = 1\n" * 8000)
            held.advance(40)
        assert "client disconnected" in held.messages[-1]


def test_connections_are_few_enough_for_this_process() -> None:
    held = robot()
    ports = listening(held)
    made = [socket.create_connection(("127.0.0.1", ports.dashboard), timeout=10) for _ in range(MOST_CLIENTS + 2)]
    held.advance(5 + len(made))
    assert f"{MOST_CLIENTS} are connected" in held.messages[-1]
    for client in made:
        client.close()
    held.advance(3)
    with connected(held, ports.dashboard) as again:
        held.advance(2)
        assert again.recv(100).startswith(b"Connected")


def test_the_dashboard_answers_a_flood_bit_by_bit() -> None:
    held = robot()
    ports = listening(held)
    with connected(held, ports.dashboard) as client:
        client.sendall(b"robotmode\n" * 500)
        held.advance(30)
        client.settimeout(10)
        found = b""
        while found.count(b"Robotmode") < 500:
            found += client.recv(1 << 16)


def test_a_text_is_looked_at_once() -> None:
    arriving = ScriptBuffer()
    whole = "def a():\n" + "  x = 1\n" * 100 + "end\n"
    for character in whole[:-1]:
        arriving.text += character
        assert arriving.take() == ""
    arriving.text += "\nstopj(2)\nrest"
    assert arriving.take() == whole
    assert arriving.take() == "stopj(2)\n"
    assert arriving.take() == ""
    assert arriving.text == "rest"


def test_a_burst_comes_back_with_the_robots_time() -> None:
    held = served()
    turns = BURST // 3
    script = f"""def bursts():
  n = 0
  while n < 2:
    k = 0
    while k < {turns // 2}:
      k = k + 1
    end
    sleep(0.3)
    n = n + 1
  end
end
"""
    assert "its last line is done" in runs(held, script).messages[-1]


def test_a_pose_has_six_numbers() -> None:
    held = served()
    assert "p[...]: expected six numbers" in runs(held, "def a():\n  x = p[1, 2, 3]\nend\n").messages[-1]
    with pytest.raises(ScriptError, match="nested too deeply"):
        held.load_script("x = " + "[" * 100 + "1" + "]" * 100 + "\n")
