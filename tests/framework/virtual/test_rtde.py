"""RTDE byte by byte, according to the manufacturer's guide."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from virtual_robots import Client, message, robot

from dmframe.virtual import VirtualRobot
from dmframe.virtual.registers import INPUTS, OUTPUT_REGISTERS, OUTPUTS, packed, size_of, type_of
from dmframe.virtual.rtde import Rtde


@pytest.fixture(scope="module")
def held() -> VirtualRobot:
    return robot()


def test_versions(held: VirtualRobot) -> None:
    client = Client(held)
    assert client.request("V", b"\0\2") == ("V", b"\1")
    assert client.request("V", b"\0\7") == ("V", b"\0")
    assert client.request("v") == ("v", struct.pack(">4I", 5, 11, 0, 108249))
    assert Client(robot(series="cb3")).request("v")[1][:4] == struct.pack(">I", 3)


def test_recipes_have_types_and_what_is_not_found(held: VirtualRobot) -> None:
    client = Client(held)
    client.request("V", b"\0\2")
    rate = struct.pack(">d", 500.0)
    assert client.request("O", rate + b"timestamp,actual_q,joint_mode") == ("O", b"\1DOUBLE,VECTOR6D,VECTOR6INT32")
    assert client.request("S") == ("S", b"\1")
    assert client.request("O", rate + b"timestamp,no_such,output_int_register_48") == (
        "O",
        b"\0DOUBLE,NOT_FOUND,NOT_FOUND",
    )
    assert client.request("S") == ("S", b"\0")
    assert client.request("I", b"input_int_register_24,input_double_register_47,") == ("I", b"\1INT32,DOUBLE")
    assert client.request("I", b"speed_slider_mask") == ("I", b"\2UINT32")
    assert client.request("I", b"actual_q") == ("I", b"\0NOT_FOUND")
    assert client.request("P") == ("P", b"\1")
    client.rtde.close()


def test_an_input_belongs_to_one_client(held: VirtualRobot) -> None:
    others = list[Rtde]()
    first, second = Client(held, others), Client(held, others)
    assert first.request("I", b"input_int_register_3")[1] == b"\1INT32"
    assert second.request("I", b"input_int_register_3,input_int_register_4")[1] == b"\0IN_USE,INT32"
    first.rtde.close()
    assert second.request("I", b"input_int_register_3,input_int_register_4")[1] == b"\1INT32,INT32"
    second.rtde.close()


def test_every_value_has_the_size_of_its_type(held: VirtualRobot) -> None:
    names = [*OUTPUTS, *OUTPUT_REGISTERS, *(name for name in INPUTS if name.startswith("input_"))]
    assert len(names) > 500
    for name in names:
        kind = type_of(name)
        assert kind is not None
        assert len(packed([name], held)) == size_of(kind), name


def test_samples_come_at_the_frequency_that_was_requested() -> None:
    held = robot()
    client = Client(held)
    client.begin(["timestamp", "actual_q", "runtime_state"], frequency=125.0)
    held.advance(16)
    found = client.samples("d6dI")
    assert [round(sample[0] / held.dt) for sample in found] == [1, 5, 9, 13]
    assert np.array_equal(found[0][1:7], [*found[0][1:7]])
    assert found[-1][-1] == 1
    client.request("P")
    held.advance(8)
    assert client.received() == []


def test_a_late_sample_is_the_one_of_its_time() -> None:
    held = robot(measurement_delay=3)
    client = Client(held)
    client.begin(["timestamp"])
    held.advance(5)
    assert [round(sample[0] / held.dt) for sample in client.samples("d")] == [1, 2]


def test_version_1_has_no_frequency_and_no_recipes_in_samples() -> None:
    held = robot()
    client = Client(held)
    assert client.request("O", b"robot_mode") == ("O", b"INT32")
    assert client.request("S") == ("S", b"\1")
    held.advance()
    assert client.received() == [("U", struct.pack(">i", 7))]


def test_inputs_reach_registers_outputs_and_the_slider() -> None:
    held = robot(command_delay=2)
    client = Client(held)
    names = [
        "input_int_register_24",
        "input_bit_registers0_to_31",
        "standard_digital_output_mask",
        "standard_digital_output",
        "standard_analog_output_mask",
        "standard_analog_output_0",
        "standard_analog_output_1",
        "external_force_torque",
    ]
    client.begin(["actual_digital_output_bits"], names)
    client.write("iIBBBdd6d", -5, 1 << 7, 0b110, 0b010, 2, 0.1, 0.2, *range(6))
    held.advance(2)
    assert held.registers.values["input_int_register_24"] == 0
    held.advance()
    values = held.registers.values
    assert values["input_int_register_24"] == -5
    assert values["input_bit_register_7"] is True
    assert values["external_force_torque"] == [0, 1, 2, 3, 4, 5]
    assert held.analog_outputs == [0.0, 0.2]
    assert client.samples("Q")[-1] == (0b010,)


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (message("U", b"\1\0"), b"data: expected the number of an input recipe"),
        (message("U"), b"data: expected the number of an input recipe"),
        (message("Z"), b"unknown message 'Z'"),
        (message("V", b"\0\2") + message("O", b"\0"), b"outputs: expected a frequency and a list of names"),
        (message("I", b"input_int_register_9") + message("U", b"\1\0"), b"data: expected 5 bytes for recipe 1"),
    ],
)
def test_an_error_is_reported_in_a_text_message(held: VirtualRobot, data: bytes, text: bytes) -> None:
    client = Client(held)
    assert client.rtde.received(data)
    kind, text_message = client.received()[-1]
    assert kind == "M"
    assert text_message[1 : 1 + text_message[0]] == text
    client.rtde.close()


def test_messages_arrive_in_any_pieces(held: VirtualRobot) -> None:
    client = Client(held)
    for byte in message("V", b"\0\2") + message("v"):
        assert client.rtde.received(bytes([byte]))
    assert [kind for kind, _ in client.received()] == ["V", "v"]
    assert not client.rtde.received(b"\0\1V")  # shorter than its own header
    client.rtde.close()


def test_no_client_is_left_behind(held: VirtualRobot) -> None:
    before = len(held.listeners)
    client = Client(held)
    client.rtde.close()
    assert len(held.listeners) == before
