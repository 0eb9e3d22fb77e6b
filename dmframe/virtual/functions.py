"""Functions that a script may call on the robot. Those that wait are generators that yield once a cycle."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from dmframe.common.errors import EngineError
from dmframe.virtual.arithmetic import FUNCTIONS, Pose, is_number, six, text
from dmframe.virtual.budget import COSTS, INVERSE, Budget, weight
from dmframe.virtual.motion import Motion, PathMotion, Servo, Speed, Stop, cycles, straight
from dmframe.virtual.registers import INPUTS
from dmframe.virtual.socket_functions import SocketFunctions, Waits, waits
from dmframe.virtual.words import ScriptError

if TYPE_CHECKING:
    from dmframe.virtual.program import Program
    from dmframe.virtual.robot import VirtualRobot

STEADY: Final = 1e-3
"""Joint speed below which the robot is steady [rad/s]."""

NEXT_STEPS: Final = 20
"""Steps of the inverse kinematics for the next point of a line."""


@final
class Halted(Exception):
    """A script ends itself."""


def names_of(kind: type) -> frozenset[str]:
    """Names of the functions that a script may call."""
    registers = {f"{side}_{word}_register" for side in _SIDES for word in _REGISTERS}
    return _own(kind) | FUNCTIONS.keys() | _READINGS.keys() | _MISSING.keys() | registers


def waiting_of(kind: type) -> frozenset[str]:
    """Names of those that take time."""
    return frozenset(name for name in _own(kind) if getattr(getattr(kind, name), "waits", False))


def _own(kind: type) -> frozenset[str]:
    names = {name for base in kind.__mro__[:-1] for name in vars(base)}
    return frozenset(name for name in names if not name.startswith("_") and name not in ("close", "table", "cycle"))


def _list(values: np.ndarray) -> list[float]:
    found: list[float] = values.tolist()
    return found


def _int32(value: Any) -> int:
    return (int(value) + 2**31) % 2**32 - 2**31


_SIDES: Final = ("read_input", "read_output", "write_output")
_REGISTERS: Final[Mapping[str, tuple[str, Callable[[Any], Any]]]] = {
    "integer": ("int", _int32),
    "float": ("double", float),
    "boolean": ("bit", bool),
}
"""Register kinds: word in the function's name -> kind in `Registers`, and conversion of a value."""
_READINGS: Final[Mapping[str, Callable[[VirtualRobot], Any]]] = {
    "get_steptime": lambda robot: robot.dt,
    "get_actual_joint_positions": lambda robot: _list(robot.q),
    "get_joint_positions": lambda robot: _list(robot.q),
    "get_actual_joint_speeds": lambda robot: _list(robot.dq),
    "get_joint_speeds": lambda robot: _list(robot.dq),
    "get_target_joint_positions": lambda robot: _list(robot.target.q),
    "get_target_joint_speeds": lambda robot: _list(robot.target.qd),
    "get_target_joint_accelerations": lambda robot: _list(robot.target.qdd),
    "get_joint_torques": lambda robot: _list(robot.torque),
    "get_actual_tcp_pose": lambda robot: Pose(_list(robot.arm.pose(robot.q))),
    "get_actual_tool_flange_pose": lambda robot: Pose(_list(robot.arm.pose(robot.q))),
    "get_target_tcp_pose": lambda robot: Pose(_list(robot.arm.pose(robot.target.q))),
    "get_actual_tcp_speed": lambda robot: _list(robot.arm.jacobian(robot.q) @ robot.dq),
    "get_target_tcp_speed": lambda robot: _list(robot.arm.jacobian(robot.target.q) @ robot.target.qd),
    "get_tcp_offset": lambda robot: Pose([0.0] * 6),
    "get_target_payload": lambda robot: robot.payload[0],
    "get_target_payload_cog": lambda robot: list(robot.payload[1:]),
    "is_steady": lambda robot: robot.target.still and bool(np.max(np.abs(robot.dq)) < STEADY),
}
"""Functions of scripts that have no argument and read the robot."""
_MISSING: Final[Mapping[str, str]] = {
    "force": "force sensor",
    "get_joint_temp": "temperatures",
    "get_controller_temp": "temperatures",
    "get_tool_current": "tool",
}
"""Functions of scripts that return NaN, and the quantity that the model does not have."""


@final
class Functions(SocketFunctions):
    """Functions of one script.

    Names, order and defaults of arguments follow the maker's manual; ``*_`` collects arguments without effect.
    """

    def __init__(self, robot: VirtualRobot, program: Program, allowance: Budget) -> None:
        super().__init__(robot)
        self._robot, self._program, self._allowance = robot, program, allowance
        found: dict[str, Callable[..., Any]] = {**FUNCTIONS, **{name: getattr(self, name) for name in _own(Functions)}}
        found |= {name: partial(value, robot) for name, value in _READINGS.items()}
        found |= {name: partial(self._no_value, name, what) for name, what in _MISSING.items()}
        found |= self._register_functions()

        def counted(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
            cost = COSTS.get(name, 1)

            def call(*given: Any, **named: Any) -> Any:
                allowance.spend(cost + sum(map(weight, given)) + sum(map(weight, named.values())))
                return function(*given, **named)

            return call

        self.table: Mapping[str, Any] = {name: counted(name, function) for name, function in found.items()}

    def close(self) -> None:
        """Close the script's sockets."""
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
        return self._moved(PathMotion(path, length, _positive("movej: v", v), _positive("movej: a", a)))

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
            last[0] = robot.arm.inverse(_between(start, goal, s / length), last[0], NEXT_STEPS)
            return last[0]

        return self._moved(PathMotion(at, length, _positive("movel: v", v), _positive("movel: a", a)))

    @waits
    def sync(self) -> Waits:
        yield

    @waits
    def sleep(self, t: Any) -> Waits:
        for _ in range(cycles(float(t), self._robot.dt) if t > 0 else 0):
            yield

    def protective_stop(self) -> None:
        self._robot.protective_stop("requested by the script")
        raise Halted  # the robot has ended the program that runs here

    # measurements; `_READINGS` has those without arguments

    def get_actual_joint_positions_history(self, steps: Any = 0) -> list[float]:
        past = self._robot.past
        return _list(past[-1 - min(max(0, int(steps)), len(past) - 1)])

    def set_tcp(self, pose: Any, *_: Any) -> None:
        if any(six(pose)):
            raise ScriptError("set_tcp: expected zeros: the virtual robot's only tool is its flange")

    def set_payload(self, m: Any, cog: Any = (0.0, 0.0, 0.0)) -> None:
        mass, place = float(m), [float(part) for part in cog]
        if len(place) != 3 or not all(map(math.isfinite, (mass, *place))):
            raise ScriptError(f"set_payload: expected a mass and three numbers, found {m} and {len(place)} numbers")
        self._robot.payload = [mass, *place]

    def get_forward_kin(self, q: Any = None, tcp: Any = None) -> Pose:
        if tcp is not None and any(six(tcp)):
            raise ScriptError("get_forward_kin: expected zeros as tcp: the virtual robot's only tool is its flange")
        return Pose(_list(self._robot.arm.pose(self._robot.q if q is None else six(q))))

    def get_inverse_kin(self, x: Any, qnear: Any = None, *_: Any) -> list[float]:
        near = self._robot.target.q if qnear is None else six(qnear)
        try:
            return _list(self._inverse(six(x), near))
        except EngineError as fault:  # the script continues; NaN instead of an outdated result
            return self._unknown(fault.text)

    def get_inverse_kin_has_solution(self, x: Any, qnear: Any = None, *_: Any) -> bool:
        return math.isfinite(self.get_inverse_kin(x, qnear)[0])

    # quantities that the model does not have: NaN and a message

    def _unknown(self, why: str) -> list[float]:
        self._robot.report(f"{self._program.name}: {why}; the result is NaN")
        return [math.nan] * 6

    def _no_value(self, name: str, what: str, *_: Any, **__: Any) -> float:
        return self._unknown(f"{name}: the virtual robot has no {what}")[0]

    def get_tcp_force(self) -> list[float]:
        return self._unknown("get_tcp_force: the virtual robot has no force sensor")

    def is_within_safety_limits(self, x: Any) -> bool:
        arm = self._robot.arm
        try:
            q = self._joints(x)
        except EngineError:
            return False
        return bool(np.all((arm.lower <= q) & (q <= arm.upper)))

    # registers, inputs and outputs

    def _register_functions(self) -> Iterator[tuple[str, Callable[..., Any]]]:
        """``read_input_float_register`` and its kind, by name."""
        registers = self._robot.registers

        def read(side: str, kind: str, cast: Callable[[Any], Any]) -> Callable[..., Any]:
            return lambda address: cast(registers.values[registers.register(side, kind, address)])

        def write(kind: str, cast: Callable[[Any], Any]) -> Callable[..., None]:
            def call(address: Any, value: Any) -> None:
                registers.values[registers.register("output", kind, address)] = cast(value)

            return call

        for word, (kind, cast) in _REGISTERS.items():
            yield f"read_input_{word}_register", read("input", kind, cast)
            yield f"read_output_{word}_register", read("output", kind, cast)
            yield f"write_output_{word}_register", write(kind, cast)

    def set_standard_digital_out(self, n: Any, b: Any) -> None:
        self._output(n, 8, 0, b)

    set_digital_out = set_standard_digital_out

    def set_configurable_digital_out(self, n: Any, b: Any) -> None:
        self._output(n, 8, 8, b)

    def set_tool_digital_out(self, n: Any, b: Any) -> None:
        self._output(n, 2, 16, b)

    def _output(self, n: Any, count: int, first: int, b: Any) -> None:
        if not is_number(n) or not 0 <= n < count or n != int(n):
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
            raise ScriptError(f"rtde_set_watchdog: expected an input, as input_int_register_0; found {variable_name}")
        most = cycles(1 / _positive("rtde_set_watchdog: min_frequency", min_frequency), self._robot.dt)
        self._robot.registers.written[str(variable_name)] = self._robot.cycles
        self._robot.watchdogs[str(variable_name)] = (most, str(action))

    # messages, and functions without effect

    def textmsg(self, s1: Any = "", s2: Any = "") -> None:
        self._robot.report(f"{text(s1)}{text(s2)}")

    def popup(self, s: Any, *_: Any, **__: Any) -> None:
        self._robot.report(f"popup: {text(s)}")

    def force_mode_set_damping(self, *_: Any) -> None:
        """No effect: force mode is not emulated, but scripts set its parameters before they use it."""

    force_mode_set_gain_scaling = force_mode_set_damping

    def set_gravity(self, d: Any, *_: Any) -> None:
        """No effect: the plant has the graph's gravity."""

    def _joints(self, place: Any) -> np.ndarray:
        """Six joint angles, by inverse kinematics for a pose."""
        return self._inverse(six(place), self._robot.target.q) if isinstance(place, Pose) else six(place)

    def _inverse(self, pose: np.ndarray, near: np.ndarray) -> np.ndarray:
        return self._robot.arm.inverse(pose, near, spend=lambda: self._allowance.spend(INVERSE))


def _positive(what: str, value: Any) -> float:
    if not is_number(value) or not value > 0:
        raise ScriptError(f"{what}: expected a positive number, found {value}")
    return float(value)


def _turn(start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    import pinocchio as pin

    found: np.ndarray = pin.log3(pin.exp3(goal[3:]) @ pin.exp3(start[3:]).T)
    return found


def _between(start: np.ndarray, goal: np.ndarray, fraction: float) -> np.ndarray:
    import pinocchio as pin

    rotation = pin.exp3(fraction * _turn(start, goal)) @ pin.exp3(start[3:])
    return np.concatenate([start[:3] + fraction * (goal[:3] - start[:3]), pin.log3(rotation)])
