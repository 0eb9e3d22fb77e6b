"""Virtual closed robot: emulates a UR controller around a graph's arm and its hidden servo, without hardware."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, Final, Literal, Protocol, final

import numpy as np

from dmframe.common.errors import DmframeError, EngineError, ValueFault
from dmframe.config import BaseGraph
from dmframe.runtime.ur_arm import JOINTS
from dmframe.simulate.engine import Choice
from dmframe.virtual.arm import Arm, arm_of
from dmframe.virtual.behaviour import Checked, count, fraction
from dmframe.virtual.budget import BURSTS, MOST_SECONDARY, RATE, Budget
from dmframe.virtual.motion import Motion, Stop, Target
from dmframe.virtual.plant import Plant
from dmframe.virtual.registers import Registers
from dmframe.virtual.safety import EMERGENCY, POWER_OFF, PROTECTIVE, Safety

if TYPE_CHECKING:
    from dmframe.virtual.program import Program
    from dmframe.virtual.rtde import Rtde
    from dmframe.virtual.server import Ports, Servers

Series = Literal["cb3", "e"]
RATES: Final[Mapping[str, float]] = {"cb3": 125.0, "e": 500.0}
"""Cycle rate of the robot's controller [Hz]."""
VERSIONS: Final[Mapping[str, tuple[int, int, int, int]]] = {"cb3": (3, 15, 8, 106339), "e": (5, 11, 0, 108249)}
"""Software version that the controller reports."""
SAFE_DECELERATION: Final = 20.0
"""Deceleration of a safety stop [rad/s^2]; the makers publish load-dependent stopping times instead."""
OVER: Final = 1.05
"""Measured speed over the limit that stops the robot; a servo overshoots its command by a few percent."""

MOST_TEXT: Final = 2000
"""Maximum length of a stored message [characters]."""
PAST: Final = 1000
"""Samples of the joint angles that are stored for scripts."""


class Listener(Protocol):
    """Callback object of `VirtualRobot.listeners`."""

    def cycle(self, robot: VirtualRobot) -> None:
        """Called at the end of each cycle, after the robot has moved."""


@final
class VirtualRobot:
    """Emulated UR whose plant is the robot and the hidden servo of a graph.

    The robot changes only in `advance`. Each cycle reads the inputs that clients wrote, runs their script, sets the
    target joint speeds, integrates the plant, and sends the next sample. A command that answers a sample therefore acts
    from that sample on, as in a simulation; `command_delay` and `measurement_delay` insert samples.

    Parameters
    ----------
    series
        ``cb3`` (125 Hz) or ``e`` (500 Hz).
    slider
        Speed slider, 0 to 1.
    command_delay, measurement_delay
        Delay of client inputs and of samples [cycles].
    lost
        Fraction of samples that are not sent, drawn with `seed`.
    engine
        As in `simulate`.

    Attributes
    ----------
    time : s
        Time of the robot's clock.
    q, dq : (6,), rad and rad/s
        Measured joint angles and velocities.
    target
        Joint targets of the controller.
    safety
        Safety mode, and the reason of the last stop.
    messages
        The latest messages of scripts, stops and faults, with their times; `message_count` counts all of them.
    late
        Number of cycles that `serve` started more than a cycle late.
    encoded, bursts
        Values of this cycle as clients receive them, and the operations with which programs begin.

    Raises
    ------
    RobotError
        The graph's robot is not a UR.
    EngineError
        The graph's plant cannot be separated from the controller; see `Plant`.
    ValueFault
        An argument is out of its range.
    """

    slider: Checked[float] = Checked(fraction)
    lost: Checked[float] = Checked(fraction)
    command_delay: Checked[int] = Checked(count)
    measurement_delay: Checked[int] = Checked(count)
    dt: float
    arm: Arm
    q: np.ndarray
    dq: np.ndarray
    target: Target
    safety: Safety
    registers: Registers
    version: tuple[int, int, int, int]
    digital_outputs: int
    analog_outputs: list[float]
    payload: list[float]

    def __init__(
        self,
        graph: BaseGraph,
        *,
        series: Series = "e",
        slider: float = 1.0,
        command_delay: int = 0,
        measurement_delay: int = 0,
        lost: float = 0.0,
        seed: int = 0,
        engine: Choice = "auto",
    ) -> None:
        if series not in RATES:
            raise ValueFault(f"series: expected cb3 or e, found {series!r}")
        self.series: Series = series
        self.dt = 1 / RATES[series]
        self.arm = arm_of(graph)
        self.plant = Plant(graph, self.dt, engine=engine)
        if self.plant.n != len(self.arm.places):
            raise EngineError(f"{graph.name}: expected a command for each joint, found {self.plant.n} numbers")
        self.name = graph.name
        self.version = VERSIONS[series]
        self.registers, self.safety = Registers(), Safety()
        self.digital_outputs, self.analog_outputs, self.payload = 0, [0.0, 0.0], [0.0, 0.0, 0.0, 0.0]
        self.messages: deque[str] = deque(maxlen=1000)
        self.message_count = 0
        self.past: deque[np.ndarray] = deque(maxlen=PAST)
        self.program: Program | None = None
        self.secondary: list[Program] = []
        self.motion: Motion | None = None
        self.listeners: list[Listener] = []
        self.watchdogs: dict[str, tuple[int, str]] = {}
        self.late = 0
        self.cycles = 0
        self._inputs: deque[tuple[int, Mapping[str, Any]]] = deque()
        self._draw = np.random.default_rng(seed)
        self._to_lose, self.sample_lost = 0, False
        self._servers: Servers | None = None
        self.encoded, self.bursts = dict[str, bytes](), Budget(RATE * self.dt, BURSTS, BURSTS)
        self.slider, self.command_delay = slider, command_delay
        self.measurement_delay, self.lost = measurement_delay, lost
        self._measure()
        self.target = Target(self.q.copy())

    @property
    def time(self) -> float:
        """Time of the robot's clock [s]."""
        return self.cycles * self.dt

    @property
    def scaling(self) -> float:
        """Scaling of the target speeds: the slider, or 0 while the robot is stopped."""
        return self.slider if self.safety.ready else 0.0

    @property
    def torque(self) -> np.ndarray:
        """Motor torques at the six joints, K u [N m]; 0 at joints that the graph holds."""
        return self.arm.six(self.plant.torque)

    @property
    def running(self) -> bool:
        """True while a script runs."""
        return self.program is not None

    def advance(self, cycles: int = 1) -> None:
        """Compute some cycles, without waiting for real time."""
        for _ in range(cycles):
            if self._servers is not None:
                self._servers.poll()
            self._cycle()

    def _cycle(self) -> None:
        while self._inputs and self._inputs[0][0] <= self.cycles:
            self._take(self._inputs.popleft()[1])
        self._watch()
        self.bursts.cycle()
        if self.program is not None and (fault := self.program.cycle()) is not None:
            self.end_program(fault)
        for program in list(self.secondary):
            if (fault := program.cycle()) is not None:
                self.secondary.remove(program)
                program.close()
                self.report(f"{program.name} ends: {fault}")
        self._move()
        self.cycles += 1
        self._measure()
        self.sample_lost = self._draw.random() < self.lost or self._to_lose > 0
        self._to_lose = max(0, self._to_lose - 1)
        self.encoded.clear()
        for listener in list(self.listeners):
            listener.cycle(self)
        if self._servers is not None:  # after the listeners, which queue their messages
            self._servers.cycle()

    def _move(self) -> None:
        target = self.target
        speed = np.zeros(6) if self.motion is None else self._speed(self.motion)
        if self.safety.ready and (fault := self.arm.refused(speed, target.q + speed * self.dt)):
            self.protective_stop(fault)
            assert self.motion is not None
            speed = self._speed(self.motion)
        for k in self.arm.still:
            speed[k] = 0.0
        self.target = Target(target.q + speed * self.dt, speed, (speed - target.qd) / self.dt)
        if not self.plant.move(speed[list(self.arm.places)]):
            self.emergency_stop("the arm's state is no longer finite")
        if isinstance(self.motion, Stop) and self.motion.done:
            self.motion = None

    def _speed(self, motion: Motion) -> np.ndarray:
        """Joint speeds of the next cycle; if the motion fails, end its script and decelerate."""
        try:
            with np.errstate(all="ignore"):  # NaN leads to a protective stop
                return motion.speed(self.target, self.dt, self.slider)
        except (ArithmeticError, ValueError, DmframeError) as fault:  # for example a line that leaves the workspace
            self.motion = Stop()
            self.end_program(getattr(fault, "text", None) or f"{type(fault).__name__}: {fault}")
            self.motion = Stop()
            return self.motion.speed(self.target, self.dt, self.slider)

    def _measure(self) -> None:
        self.q = self.arm.six(self.plant.q, self.arm.held)
        self.dq = self.arm.six(self.plant.dq)
        self.past.append(self.q)
        if self.safety.ready:
            over = np.flatnonzero(np.abs(self.dq) > OVER * self.arm.velocity)
            if over.size:
                k = int(over[0])
                self.protective_stop(f"{JOINTS[k]} moves with {self.dq[k]:.4g} rad/s, its limit is exceeded")

    def write(self, values: Mapping[str, Any]) -> None:
        """Write inputs by name, as a client does; they act after `command_delay` cycles."""
        self._inputs.append((self.cycles + self.command_delay, values))

    def _take(self, values: Mapping[str, Any]) -> None:
        for name, value in values.items():
            self.registers.put(name, value, self.cycles)
        if values.get("speed_slider_mask", 0) & 1:
            slider = values.get("speed_slider_fraction", math.nan)
            if 0 <= slider <= 1:
                self.slider = slider
        for first, kind in ((0, "standard"), (8, "configurable"), (16, "tool")):
            mask = values.get(f"{kind}_digital_output_mask", 0)
            self.set_outputs(mask << first, values.get(f"{kind}_digital_output", 0) << first)
        for k in range(2):
            if values.get("standard_analog_output_mask", 0) >> k & 1:
                self.analog_outputs[k] = values.get(f"standard_analog_output_{k}", 0.0)

    def set_outputs(self, mask: int, bits: int) -> None:
        """Set the digital outputs of the mask."""
        self.digital_outputs = self.digital_outputs & ~mask | bits & mask

    def _watch(self) -> None:
        for name, (most, action) in self.watchdogs.items():
            if self.running and self.cycles - self.registers.written.get(name, self.cycles) > most:
                if action != "ignore":
                    self.end_program(f"watchdog: {name} was not written for {most} cycles")
                return

    def report(self, text: str) -> None:
        """Store a message, at most `MOST_TEXT` characters of it."""
        self.message_count += 1
        self.messages.append(f"{self.time:.3f} s: {text[:MOST_TEXT]}")

    def run_program(self, program: Program) -> None:
        """Start a script; unless it is secondary, it replaces the running one."""
        if program.secondary:
            if len(self.secondary) < MOST_SECONDARY:
                self.secondary.append(program)
                return None
            return self.report(f"{program.name}: not started: {MOST_SECONDARY} secondary programs are running")
        if self.program is not None:
            self.end_program("another program begins")
        if not self.safety.ready:
            return self.report(f"{program.name}: not started: the robot is stopped")
        self.watchdogs.clear()
        self.program = program
        return self.report(f"{program.name} begins")

    def end_program(self, why: str) -> None:
        """End the running script and decelerate the arm."""
        if self.program is None:
            return
        program, self.program = self.program, None
        program.close()
        self.watchdogs.clear()
        self.report(f"{program.name} ends: {why}")
        self.release()

    def release(self) -> None:
        """Decelerate the arm after its last motion command."""
        if self.safety.ready and (self.motion is not None or not self.target.still):
            self.motion = Stop()

    def protective_stop(self, reason: str = "requested") -> None:
        """Stop as after a passed limit; `unlock` releases it."""
        self._stop(PROTECTIVE, f"protective stop: {reason}")

    def emergency_stop(self, reason: str = "the button is pressed") -> None:
        """Stop and switch the power off; leave it by `release_emergency_stop`, power on and brake release."""
        self._stop(EMERGENCY, f"emergency stop: {reason}")

    def _stop(self, mode: int, reason: str) -> None:
        if not self.safety.stop(mode, reason):
            return
        self.report(reason)
        self.end_program(reason)
        self.motion = Stop(SAFE_DECELERATION)

    def unlock(self) -> bool:
        """Release a protective stop; False if there is none, or the arm still moves."""
        return self.target.still and self.safety.release(PROTECTIVE)

    def release_emergency_stop(self) -> bool:
        """Release the emergency stop button; False if it is not pressed. The power stays off."""
        return self.safety.release(EMERGENCY)

    def power_off(self) -> None:
        """Switch off the power of the arm: it stops, and the servo holds it as a substitute for the brakes."""
        self.safety.power(POWER_OFF)
        self.end_program("the power is off")
        self.motion = Stop(SAFE_DECELERATION)

    def lose(self, samples: int) -> None:
        """Drop the next samples."""
        self._to_lose = count("samples", samples)

    def load_script(self, text: str) -> None:
        """Run a script as if a client had sent it. Raises `ScriptError` if it is invalid."""
        from dmframe.virtual.program import Program

        self.run_program(Program(text, self))

    def listen(self, host: str = "127.0.0.1", ports: Ports | None = None) -> Ports:
        """Open the ports, by default those of a UR, and return them. Raises `OutputError` if one is in use."""
        from dmframe.virtual.server import Ports, Servers

        self.close()
        self._servers = Servers(self, host, ports or Ports())
        return self._servers.ports

    def close(self) -> None:
        """End the scripts and close all ports."""
        self.end_program("the robot is shut down")
        while self.secondary:
            self.secondary.pop().close()
        if self._servers is not None:
            self._servers.close()
            self._servers = None

    def __enter__(self) -> VirtualRobot:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def owing(self) -> list[Rtde]:
        """RTDE clients that have not answered the last sample, while a script runs."""
        return self._servers.owing if self._servers is not None and self.running else []

    def serve(self, wanted: Callable[[], bool] = lambda: True, patience: float = 0.0) -> None:
        """Run while `wanted()` is true, in real time or in step with a client; see `dmframe.virtual.pace`."""
        from dmframe.virtual.pace import serve

        serve(self, wanted, patience)

    def in_background(self, patience: float = 0.0) -> AbstractContextManager[VirtualRobot]:
        """Run as `serve` does, in a thread, until the ``with`` block ends."""
        from dmframe.virtual.pace import in_background

        return in_background(self, patience)

    def wait(self, time: float) -> None:
        """Serve the ports for some time [s] without advancing the clock."""
        from time import sleep

        if self._servers is None:
            sleep(time)
        else:
            self._servers.poll(time)
