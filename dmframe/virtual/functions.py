"""The functions that a script finds on the robot. Those that wait are generators, and yield once a cycle."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from dmframe.errors import EngineError
from dmframe.virtual.arithmetic import FUNCTIONS, Pose, six, text
from dmframe.virtual.budget import COSTS, Allowance
from dmframe.virtual.motion import Along, Motion, Servo, Speed, Stop, cycles, straight
from dmframe.virtual.registers import INPUTS
from dmframe.virtual.socket_functions import SocketFunctions, Waits, waits
from dmframe.virtual.words import ScriptError

if TYPE_CHECKING:
    from dmframe.virtual.program import Program
    from dmframe.virtual.robot import VirtualRobot

STEADY: Final = 1e-3
"""Of speeds [rad/s] at which the robot counts as standing."""


@final
class Halted(Exception):
    """A script ends itself."""


def names_of(kind: type) -> frozenset[str]:
    """The functions that a script may call."""
    return _own(kind) | FUNCTIONS.keys()


def waiting_of(kind: type) -> frozenset[str]:
    """Those that take time."""
    return frozenset(name for name in _own(kind) if getattr(getattr(kind, name), "waits", False))


def _own(kind: type) -> frozenset[str]:
    names = {name for base in kind.__mro__[:-1] for name in vars(base)}
    return frozenset(name for name in names if not name.startswith("_") and name not in _OWN)


_OWN: Final = frozenset(("close", "table", "cycle"))


@final
class Functions(SocketFunctions):
    """The functions of one script.

    Names, order and defaults of arguments are those of the maker's manual; what a function does not heed is taken by
    ``*_``.
    """

    def __init__(self, robot: VirtualRobot, program: Program, allowance: Allowance) -> None:
        super().__init__(robot)
        self._robot, self._program = robot, program
        found = {**FUNCTIONS, **{name: getattr(self, name) for name in _own(Functions)}}

        def paid(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
            cost = COSTS.get(name, 1)

            def call(*given: Any, **named: Any) -> Any:
                allowance.spend(cost)
                return function(*given, **named)

            return call

        self.table: Mapping[str, Any] = {name: paid(name, function) for name, function in found.items()}

    def close(self) -> None:
        """The script is over."""
        self._sockets.close()

    # motion

    def _moved(self, motion: Motion) -> Waits:
        robot, program = self._robot, self._program
        thread = program.claim()
        robot.motion = motion
        while not motion.done and robot.motion is motion:
            yield
        program.free(thread)

    @waits
    def speedj(self, qd: Any, a: Any = 0.5, t: Any = None, *_: Any) -> Waits:
        time = None if t is None or t <= 0 else float(t)
        return self._moved(Speed(six(qd), _positive("speedj: a", a), time))

    @waits
    def speedl(self, xd: Any, a: Any = 0.5, t: Any = None, *_: Any, **__: Any) -> Waits:
        time, arm = None if t is None or t <= 0 else float(t), self._robot.arm

        def to_joints(q: np.ndarray, velocity: np.ndarray) -> np.ndarray:
            found: np.ndarray = np.linalg.lstsq(arm.jacobian(q), velocity, rcond=1e-6)[0]
            return found

        return self._moved(Speed(six(xd), _positive("speedl: a", a), time, to_joints))

    @waits
    def stopj(self, a: Any = 2.0) -> Waits:
        return self._moved(Stop(_positive("stopj: a", a)))

    @waits
    def stopl(self, a: Any = 10.0, *_: Any) -> Waits:
        return self._moved(Stop(_positive("stopl: a", a)))

    @waits
    def servoj(
        self, q: Any, a: Any = 0, v: Any = 0, t: Any = None, lookahead_time: Any = 0.1, gain: Any = 300
    ) -> Waits:
        time = self._robot.dt if t is None or t <= 0 else float(t)
        return self._moved(Servo(self._joints(q), time, float(lookahead_time)))

    @waits
    def movej(self, q: Any, a: Any = 1.4, v: Any = 1.05, t: Any = 0, r: Any = 0) -> Waits:
        path, length = straight(self._robot.target.q, self._joints(q))
        if t > 0 and length > 0:  # a third of the time to speed up, a third to slow down
            a, v = 4.5 * length / t**2, 1.5 * length / t
        return self._moved(Along(path, length, _positive("movej: v", v), _positive("movej: a", a)))

    @waits
    def movel(self, pose: Any, a: Any = 1.2, v: Any = 0.25, t: Any = 0, r: Any = 0) -> Waits:
        robot = self._robot
        goal = six(pose) if isinstance(pose, Pose) else robot.arm.pose(six(pose))
        start, q = robot.arm.pose(robot.target.q), robot.target.q
        length = max(float(np.linalg.norm(goal[:3] - start[:3])), float(np.linalg.norm(_turn(start, goal))))
        if t > 0 and length > 0:
            a, v = 4.5 * length / t**2, 1.5 * length / t
        last = [q.copy()]

        def at(s: float) -> np.ndarray:
            last[0] = robot.arm.inverse(_between(start, goal, s / length), last[0])
            return last[0]

        return self._moved(Along(at, length, _positive("movel: v", v), _positive("movel: a", a)))

    @waits
    def sync(self) -> Waits:
        yield

    @waits
    def sleep(self, t: Any) -> Waits:
        for _ in range(cycles(float(t), self._robot.dt) if t > 0 else 0):
            yield

    def protective_stop(self) -> None:
        self._robot.protective_stop("asked for by the script")
        raise Halted  # the robot has ended the program that runs here

    # what is measured

    def get_steptime(self) -> float:
        return self._robot.dt

    def get_actual_joint_positions(self) -> list[float]:
        return _list(self._robot.q)

    get_joint_positions = get_actual_joint_positions

    def get_actual_joint_positions_history(self, steps: Any = 0) -> list[float]:
        past = self._robot.past
        return _list(past[-1 - min(max(0, int(steps)), len(past) - 1)])

    def get_actual_joint_speeds(self) -> list[float]:
        return _list(self._robot.dq)

    get_joint_speeds = get_actual_joint_speeds

    def get_target_joint_positions(self) -> list[float]:
        return _list(self._robot.target.q)

    def get_target_joint_speeds(self) -> list[float]:
        return _list(self._robot.target.qd)

    def get_target_joint_accelerations(self) -> list[float]:
        return _list(self._robot.target.qdd)

    def get_actual_tcp_pose(self) -> Pose:
        return Pose(_list(self._robot.arm.pose(self._robot.q)))

    get_actual_tool_flange_pose = get_actual_tcp_pose

    def get_target_tcp_pose(self) -> Pose:
        return Pose(_list(self._robot.arm.pose(self._robot.target.q)))

    def get_actual_tcp_speed(self) -> list[float]:
        return _list(self._robot.arm.jacobian(self._robot.q) @ self._robot.dq)

    def get_target_tcp_speed(self) -> list[float]:
        target = self._robot.target
        return _list(self._robot.arm.jacobian(target.q) @ target.qd)

    def get_tcp_offset(self) -> Pose:
        return Pose([0.0] * 6)

    def set_tcp(self, pose: Any, *_: Any) -> None:
        if any(six(pose)):
            raise ScriptError("set_tcp: the virtual robot has no tool but its flange; expected zeros")

    def is_steady(self) -> bool:
        return self._robot.target.still and bool(np.max(np.abs(self._robot.dq)) < STEADY)

    def get_target_payload(self) -> float:
        return self._robot.payload[0]

    def get_target_payload_cog(self) -> list[float]:
        return list(self._robot.payload[1:])

    def set_payload(self, m: Any, cog: Any = (0.0, 0.0, 0.0)) -> None:
        mass, place = float(m), [float(part) for part in cog]
        if len(place) != 3 or not all(map(math.isfinite, (mass, *place))):
            raise ScriptError(f"set_payload: expected a mass and three numbers, found {m} and {len(place)} numbers")
        self._robot.payload = [mass, *place]

    def get_forward_kin(self, q: Any = None, tcp: Any = None) -> Pose:
        if tcp is not None and any(six(tcp)):
            raise ScriptError("get_forward_kin: the virtual robot has no tool but its flange; expected zeros as tcp")
        return Pose(_list(self._robot.arm.pose(self._robot.q if q is None else six(q))))

    def get_inverse_kin(self, x: Any, qnear: Any = None, *_: Any) -> list[float]:
        near = self._robot.target.q if qnear is None else six(qnear)
        try:
            return _list(self._robot.arm.inverse(six(x), near))
        except EngineError as fault:  # the script goes on, and its client reads no number for an old one
            return self._unknown(fault.text)

    def get_inverse_kin_has_solution(self, x: Any, qnear: Any = None, *_: Any) -> bool:
        return math.isfinite(self.get_inverse_kin(x, qnear)[0])

    # what the model does not tell: no numbers, and the script goes on

    def _unknown(self, why: str) -> list[float]:
        self._robot.tell(f"{self._program.name}: {why}; the answer is not a number")
        return [math.nan] * 6

    def get_joint_torques(self) -> list[float]:
        return _list(self._robot.torque)

    def get_tcp_force(self) -> list[float]:
        return self._unknown("get_tcp_force: the virtual robot has no sensor of forces")

    def force(self) -> float:
        return self._unknown("force: the virtual robot has no sensor of forces")[0]

    def get_joint_temp(self, j: Any) -> float:
        return self._unknown("get_joint_temp: the virtual robot has no temperatures")[0]

    def get_controller_temp(self) -> float:
        return self._unknown("get_controller_temp: the virtual robot has no temperatures")[0]

    def get_tool_current(self) -> float:
        return self._unknown("get_tool_current: the virtual robot has no tool")[0]

    def is_within_safety_limits(self, x: Any) -> bool:
        arm = self._robot.arm
        try:
            q = self._joints(x)
        except EngineError:
            return False
        return bool(np.all((arm.lower <= q) & (q <= arm.upper)))

    # registers, inputs and outputs

    def _read(self, side: str, kind: str, index: Any) -> Any:
        registers = self._robot.registers
        return registers.values[registers.register(side, kind, index)]

    def _write(self, kind: str, index: Any, value: Any) -> None:
        registers = self._robot.registers
        registers.values[registers.register("output", kind, index)] = value

    def read_input_integer_register(self, address: Any) -> int:
        return int(self._read("input", "int", address))

    def read_input_float_register(self, address: Any) -> float:
        return float(self._read("input", "double", address))

    def read_input_boolean_register(self, address: Any) -> bool:
        return bool(self._read("input", "bit", address))

    def read_output_integer_register(self, address: Any) -> int:
        return int(self._read("output", "int", address))

    def read_output_float_register(self, address: Any) -> float:
        return float(self._read("output", "double", address))

    def read_output_boolean_register(self, address: Any) -> bool:
        return bool(self._read("output", "bit", address))

    def write_output_integer_register(self, address: Any, value: Any) -> None:
        whole = int(value)
        self._write("int", address, (whole + 2**31) % 2**32 - 2**31)  # as four bytes hold it

    def write_output_float_register(self, address: Any, value: Any) -> None:
        self._write("double", address, float(value))

    def write_output_boolean_register(self, address: Any, value: Any) -> None:
        self._write("bit", address, bool(value))

    def set_standard_digital_out(self, n: Any, b: Any) -> None:
        self._output(n, 8, 0, b)

    set_digital_out = set_standard_digital_out

    def set_configurable_digital_out(self, n: Any, b: Any) -> None:
        self._output(n, 8, 8, b)

    def set_tool_digital_out(self, n: Any, b: Any) -> None:
        self._output(n, 2, 16, b)

    def _output(self, n: Any, count: int, first: int, b: Any) -> None:
        if isinstance(n, bool) or not isinstance(n, int | float) or not 0 <= n < count or n != int(n):
            raise ScriptError(f"digital output: expected a number from 0 to {count - 1}, found {n}")
        self._robot.set_outputs(1 << first + int(n), int(bool(b)) << first + int(n))

    def get_standard_digital_out(self, n: Any) -> bool:
        return 0 <= n < 64 and bool(self._robot.digital_outputs >> int(n) & 1)

    get_digital_out = get_standard_digital_out

    def get_standard_digital_in(self, n: Any) -> bool:
        return False

    get_digital_in = get_standard_digital_in

    def set_standard_analog_out(self, n: Any, f: Any) -> None:
        if n not in (0, 1):
            raise ScriptError(f"set_standard_analog_out: expected 0 or 1, found {n}")
        self._robot.analog_outputs[int(n)] = float(f)

    def rtde_set_watchdog(self, variable_name: Any, min_frequency: Any, action: Any = "pause") -> None:
        if variable_name not in INPUTS:
            raise ScriptError(f"rtde_set_watchdog: expected an input, input_int_register_0, say; found {variable_name}")
        most = cycles(1 / _positive("rtde_set_watchdog: min_frequency", min_frequency), self._robot.dt)
        self._robot.registers.written[str(variable_name)] = self._robot.cycles
        self._robot.watchdogs[str(variable_name)] = (most, str(action))

    # told, and without effect

    def textmsg(self, s1: Any = "", s2: Any = "") -> None:
        self._robot.tell(f"{text(s1)}{text(s2)}")

    def popup(self, s: Any, *_: Any, **__: Any) -> None:
        self._robot.tell(f"popup: {text(s)}")

    def force_mode_set_damping(self, *_: Any) -> None:
        """Of a mode that is not emulated; scripts set it before they use it."""

    force_mode_set_gain_scaling = force_mode_set_damping

    def set_gravity(self, d: Any, *_: Any) -> None:
        """The plant has the graph's."""

    def _joints(self, place: Any) -> np.ndarray:
        """Angles, or those of a pose."""
        return self._robot.arm.inverse(six(place), self._robot.target.q) if isinstance(place, Pose) else six(place)


def _positive(what: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
        raise ScriptError(f"{what}: expected a positive number, found {value}")
    return float(value)


def _list(values: np.ndarray) -> list[float]:
    found: list[float] = values.tolist()
    return found


def _turn(start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    import pinocchio as pin

    found: np.ndarray = pin.log3(pin.exp3(goal[3:]) @ pin.exp3(start[3:]).T)
    return found


def _between(start: np.ndarray, goal: np.ndarray, share: float) -> np.ndarray:
    import pinocchio as pin

    rotation = pin.exp3(share * _turn(start, goal)) @ pin.exp3(start[3:])
    return np.concatenate([start[:3] + share * (goal[:3] - start[:3]), pin.log3(rotation)])
