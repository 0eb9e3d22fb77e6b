"""Registers of the controller, and the inputs and outputs of RTDE by name."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final, final

from dmframe.common.errors import ValueFault

if TYPE_CHECKING:
    from dmframe.virtual.robot import VirtualRobot

FORMATS: Final[Mapping[str, str]] = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}
"""RTDE type -> `struct` format, in network byte order."""
REGISTERS: Final = 48
"""Number of integer registers, and of double registers: 0 to 23 for a fieldbus, 24 to 47 for RTDE clients."""
BITS: Final = 128


def size_of(kind: str) -> int:
    """Size of a type [bytes]."""
    return struct.calcsize(f">{FORMATS[kind]}")


@final
class Registers:
    """Registers that scripts and clients exchange; `written` is the cycle of each input's last write."""

    def __init__(self) -> None:
        self.values: dict[str, Any] = {name: _zero(kind) for name, kind in INPUTS.items()}
        self.values |= {name: _zero(kind) for name, kind in OUTPUT_REGISTERS.items()}
        self.written: dict[str, int] = {}

    def bits(self, side: str, first: int) -> int:
        """32 bit registers as one integer."""
        return sum(1 << k for k in range(32) if self.values[f"{side}_bit_register_{first + k}"])

    def put(self, name: str, value: Any, cycle: int) -> None:
        """Write one input."""
        self.written[name] = cycle
        side, _, rest = name.partition("_bit_registers")
        if rest:  # 32 at once
            first = int(rest.partition("_to_")[0])
            for k in range(32):
                self.values[f"{side}_bit_register_{first + k}"] = bool(value >> k & 1)
        self.values[name] = value

    def register(self, side: str, kind: str, index: Any) -> str:
        """Name of the register with a number. Raises `ValueFault` if there is none."""
        most = BITS if kind == "bit" else REGISTERS
        if isinstance(index, bool) or not 0 <= index < most or index != int(index):
            raise ValueFault(f"{side} {kind} register: expected a number from 0 to {most - 1}, found {index}")
        return f"{side}_{kind}_register_{int(index)}"


def _zero(kind: str) -> Any:
    return [0.0] * 6 if kind == "VECTOR6D" else False if kind == "BOOL" else 0.0 if kind == "DOUBLE" else 0


def _registers(side: str) -> dict[str, str]:
    return {
        **{f"{side}_int_register_{k}": "INT32" for k in range(REGISTERS)},
        **{f"{side}_double_register_{k}": "DOUBLE" for k in range(REGISTERS)},
        **{f"{side}_bit_register_{k}": "BOOL" for k in range(BITS)},
    }


OUTPUT_REGISTERS: Final = _registers("output")
INPUTS: Final[Mapping[str, str]] = {
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    "standard_digital_output_mask": "UINT8",
    "standard_digital_output": "UINT8",
    "configurable_digital_output_mask": "UINT8",
    "configurable_digital_output": "UINT8",
    "tool_digital_output_mask": "UINT8",
    "tool_digital_output": "UINT8",
    "standard_analog_output_mask": "UINT8",
    "standard_analog_output_type": "UINT8",
    "standard_analog_output_0": "DOUBLE",
    "standard_analog_output_1": "DOUBLE",
    "input_bit_registers0_to_31": "UINT32",
    "input_bit_registers32_to_63": "UINT32",
    "external_force_torque": "VECTOR6D",
    **_registers("input"),
}
"""Inputs that a client may write: name -> type."""

Value = Callable[["VirtualRobot"], Any]

_SIX: Final = (0.0,) * 6
OUTPUTS: Final[Mapping[str, tuple[str, Value]]] = {
    "timestamp": ("DOUBLE", lambda robot: robot.time),
    "target_q": ("VECTOR6D", lambda robot: robot.target.q),
    "target_qd": ("VECTOR6D", lambda robot: robot.target.qd),
    "target_qdd": ("VECTOR6D", lambda robot: robot.target.qdd),
    "actual_q": ("VECTOR6D", lambda robot: robot.q),
    "actual_qd": ("VECTOR6D", lambda robot: robot.dq),
    "actual_TCP_pose": ("VECTOR6D", lambda robot: robot.arm.pose(robot.q)),
    "target_TCP_pose": ("VECTOR6D", lambda robot: robot.arm.pose(robot.target.q)),
    "actual_TCP_speed": ("VECTOR6D", lambda robot: robot.arm.jacobian(robot.q) @ robot.dq),
    "target_TCP_speed": ("VECTOR6D", lambda robot: robot.arm.jacobian(robot.target.q) @ robot.target.qd),
    "target_moment": ("VECTOR6D", lambda robot: robot.torque),
    "actual_current_as_torque": ("VECTOR6D", lambda robot: robot.torque),
    "robot_mode": ("INT32", lambda robot: robot.safety.robot_mode),
    "safety_mode": ("INT32", lambda robot: robot.safety.mode),
    "safety_status": ("INT32", lambda robot: robot.safety.mode),
    "joint_mode": ("VECTOR6INT32", lambda robot: [robot.safety.joint_mode] * 6),
    "runtime_state": ("UINT32", lambda robot: 2 if robot.running else 1),
    "robot_status_bits": ("UINT32", lambda robot: int(robot.safety.powered) | int(robot.running) << 1),
    "safety_status_bits": ("UINT32", lambda robot: robot.safety.bits),
    "speed_scaling": ("DOUBLE", lambda robot: float(robot.safety.ready)),  # clients multiply it by the next
    "target_speed_fraction": ("DOUBLE", lambda robot: robot.slider),
    "actual_digital_input_bits": ("UINT64", lambda robot: 0),
    "actual_digital_output_bits": ("UINT64", lambda robot: robot.digital_outputs),
    "standard_analog_output0": ("DOUBLE", lambda robot: robot.analog_outputs[0]),
    "standard_analog_output1": ("DOUBLE", lambda robot: robot.analog_outputs[1]),
    "analog_io_types": ("UINT32", lambda robot: 0),
    "output_bit_registers0_to_31": ("UINT32", lambda robot: robot.registers.bits("output", 0)),
    "output_bit_registers32_to_63": ("UINT32", lambda robot: robot.registers.bits("output", 32)),
    "payload": ("DOUBLE", lambda robot: robot.payload[0]),
    "payload_cog": ("VECTOR3D", lambda robot: robot.payload[1:4]),
    "payload_inertia": ("VECTOR6D", lambda robot: _SIX),
    "tcp_offset": ("VECTOR6D", lambda robot: _SIX),
    "actual_main_voltage": ("DOUBLE", lambda robot: 48.0),
    "actual_robot_voltage": ("DOUBLE", lambda robot: 48.0),
    "joint_temperatures": ("VECTOR6D", lambda robot: (25.0,) * 6),
    "tool_temperature": ("DOUBLE", lambda robot: 25.0),
    "tool_mode": ("UINT32", lambda robot: 253),
    "tool_output_voltage": ("INT32", lambda robot: 0),
    "tool_analog_input_types": ("UINT32", lambda robot: 0),
    "elbow_position": ("VECTOR3D", lambda robot: (0.0,) * 3),
    "elbow_velocity": ("VECTOR3D", lambda robot: (0.0,) * 3),
    "actual_tool_accelerometer": ("VECTOR3D", lambda robot: (0.0,) * 3),
    **{
        name: ("VECTOR6D", lambda robot: _SIX)
        for name in (
            "target_current actual_current actual_current_window joint_control_output actual_TCP_force "
            "actual_joint_voltage ft_raw_wrench"
        ).split()
    },
    **{
        name: ("DOUBLE", lambda robot: 0.0)
        for name in (
            "actual_execution_time actual_momentum actual_robot_current standard_analog_input0 standard_analog_input1 "
            "io_current tool_analog_input0 tool_analog_input1 tool_output_current tcp_force_scalar"
        ).split()
    },
}
"""Outputs: name -> type, value. Torques are K u; currents, forces and temperatures, not modelled, are constants."""


def type_of(name: str) -> str | None:
    """Type of an output; None if there is none of that name."""
    if name in OUTPUTS:
        return OUTPUTS[name][0]
    return OUTPUT_REGISTERS.get(name) or (INPUTS[name] if name.startswith("input_") and name in INPUTS else None)


def packed(names: list[str], robot: VirtualRobot) -> bytes:
    """Encode outputs as RTDE sends them; each is computed once in a cycle, for all clients."""
    known = robot.encoded
    for name in names:
        if name not in known:
            known[name] = _encoded(name, robot)
    return b"".join([known[name] for name in names])


def _encoded(name: str, robot: VirtualRobot) -> bytes:
    if name in OUTPUTS:
        kind, value = OUTPUTS[name][0], OUTPUTS[name][1](robot)
    else:
        kind, value = type_of(name) or "", robot.registers.values[name]
    form = f">{FORMATS[kind]}"
    return struct.pack(form, *value) if kind.startswith("VECTOR") else struct.pack(form, value)
