"""A closed robot without hardware: a maker's controller about the arm and the hidden servo of a graph."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, Final, Literal, Protocol, final

import numpy as np

from dmframe.config.experiment import Experiment
from dmframe.diagram import Diagram
from dmframe.errors import DmframeError, EngineError, ValueFault
from dmframe.simulate.engine import Choice
from dmframe.virtual.arm import JOINTS, Arm, arm_of
from dmframe.virtual.behaviour import Behaviour, count
from dmframe.virtual.budget import MOST_BESIDE
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
"""Cycles of the maker's controller in a second."""
VERSIONS: Final[Mapping[str, tuple[int, int, int, int]]] = {"cb3": (3, 15, 8, 106339), "e": (5, 11, 0, 108249)}
"""What the controller says that it is."""
SAFE_DECELERATION: Final = 20.0
"""Of a stop for safety [rad/s^2]; the makers tell stopping times instead, which depend on the load."""
OVER: Final = 1.05
"""A measured speed over the limit by this factor stops the robot, for a servo overshoots what it is commanded."""

MOST_TEXT: Final = 2000
"""Characters of a message that are kept."""
PAST: Final = 1000
"""Samples of the joints' angles that are kept for scripts."""


class Listener(Protocol):
    """Somebody who is told of each cycle."""

    def cycle(self, robot: VirtualRobot) -> None:
        """A cycle is over, and the robot has moved."""


@final
class VirtualRobot(Behaviour):
    """A UR whose plant is the robot and the hidden servo of a graph.

    Nothing happens between calls of `advance`, each of which is one cycle of the controller: what clients wrote is
    taken, their script runs, the joints get their target speeds, the plant moves, and clients get the next sample. A
    command that answers a sample so acts from that very sample on, as in a simulation; `command_delay` and
    `measurement_delay` put samples between.

    Parameters
    ----------
    series
        ``cb3``, 125 cycles a second, or ``e``, 500.
    slider
        The speed slider, 0 to 1.
    command_delay, measurement_delay
        How many cycles later what a client writes is taken, and a sample is sent.
    lost
        Share of samples that are not sent, drawn with `seed`.
    engine
        As of `simulate`.

    Attributes
    ----------
    time : s
        Of the robot's own clock.
    q, dq : (6,), rad and rad/s
        Measured.
    target
        Where the controller wants the joints.
    safety
        In which mode it is, and why.
    messages
        The last texts of scripts, stops and faults, with their times; `told` is how many there were.
    late
        How often `serve` was late by more than a cycle.

    Raises
    ------
    RobotError
        The graph's robot is no UR.
    EngineError
        Its plant cannot stand alone; see `Plant`.
    ValueFault
        A number out of its range.
    """

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
        experiment: Experiment,
        diagram: Diagram,
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
        self.arm = arm_of(experiment)
        self.plant = Plant(experiment, diagram, self.dt, engine=engine)
        if self.plant.n != len(self.arm.places):
            raise EngineError(f"{experiment.name}: expected a command for each joint, found {self.plant.n} numbers")
        self.name = experiment.name
        self.version = VERSIONS[series]
        self.registers, self.safety = Registers(), Safety()
        self.digital_outputs, self.analog_outputs, self.payload = 0, [0.0, 0.0], [0.0, 0.0, 0.0, 0.0]
        self.messages: deque[str] = deque(maxlen=1000)
        self.told = 0
        self.past: deque[np.ndarray] = deque(maxlen=PAST)
        self.program: Program | None = None
        self.beside: list[Program] = []
        self.motion: Motion | None = None
        self.listeners: list[Listener] = []
        self.watchdogs: dict[str, tuple[int, str]] = {}
        self.late = 0
        self.cycles = 0
        self._told: deque[tuple[int, Mapping[str, Any]]] = deque()
        self._draw = np.random.default_rng(seed)
        self._to_lose, self.sample_lost = 0, False
        self._servers: Servers | None = None
        self.slider, self.command_delay = slider, command_delay
        self.measurement_delay, self.lost = measurement_delay, lost
        self._measure()
        self.target = Target(self.q.copy())

    @property
    def time(self) -> float:
        """Of the robot's clock [s]."""
        return self.cycles * self.dt

    @property
    def scaling(self) -> float:
        """What targets are scaled by now: the slider, or 0 while the robot is stopped."""
        return self._slider if self.safety.ready else 0.0

    @property
    def torque(self) -> np.ndarray:
        """What the motors do at the six joints, K u [N m]; 0 at those that the graph holds."""
        return self.arm.six(self.plant.torque)

    @property
    def running(self) -> bool:
        """True while a script runs."""
        return self.program is not None

    @property
    def runtime_state(self) -> int:
        """By the maker's numbers: 1 stopped, 2 playing."""
        return 2 if self.running else 1

    @property
    def status_bits(self) -> int:
        """Power on, and program running."""
        return int(self.safety.powered) | int(self.running) << 1

    def advance(self, cycles: int = 1) -> None:
        """Let some cycles pass, as fast as they are computed."""
        for _ in range(cycles):
            if self._servers is not None:
                self._servers.poll()
            self._cycle()

    def _cycle(self) -> None:
        while self._told and self._told[0][0] <= self.cycles:
            self._take(self._told.popleft()[1])
        self._watch()
        if self.program is not None:
            fault = self.program.cycle()
            if fault is not None:
                self.end_program(fault)
        for beside in list(self.beside):
            if (fault := beside.cycle()) is not None:
                self.beside.remove(beside)
                beside.close()
                self.tell(f"{beside.name} ends: {fault}")
        self._move()
        self.cycles += 1
        self._measure()
        self.sample_lost = self._draw.random() < self._lost or self._to_lose > 0
        self._to_lose = max(0, self._to_lose - 1)
        for listener in list(self.listeners):
            listener.cycle(self)
        if self._servers is not None:  # it sends what listeners made of the cycle
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
        """Of the coming cycle; a motion that cannot go on ends its script, and the arm slows down."""
        try:
            with np.errstate(all="ignore"):  # what is not a number is a protective stop
                return motion.speed(self.target, self.dt, self._slider)
        except (ArithmeticError, ValueError, DmframeError) as fault:  # as where a line leaves the workspace
            self.motion = Stop()
            self.end_program(getattr(fault, "text", None) or f"{type(fault).__name__}: {fault}")
            self.motion = Stop()
            return self.motion.speed(self.target, self.dt, self._slider)

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
        """Inputs by name, as a client writes them; they are taken after `command_delay` cycles."""
        self._told.append((self.cycles + self._command_delay, values))

    def _take(self, values: Mapping[str, Any]) -> None:
        for name, value in values.items():
            self.registers.put(name, value, self.cycles)
        if values.get("speed_slider_mask", 0) & 1:
            fraction = values.get("speed_slider_fraction", math.nan)
            if 0 <= fraction <= 1:
                self.slider = fraction
        for first, kind in ((0, "standard"), (8, "configurable"), (16, "tool")):
            mask = values.get(f"{kind}_digital_output_mask", 0)
            self.set_outputs(mask << first, values.get(f"{kind}_digital_output", 0) << first)
        for k in range(2):
            if values.get("standard_analog_output_mask", 0) >> k & 1:
                self.analog_outputs[k] = values.get(f"standard_analog_output_{k}", 0.0)

    def set_outputs(self, mask: int, bits: int) -> None:
        """Digital outputs: those of the mask."""
        self.digital_outputs = self.digital_outputs & ~mask | bits & mask

    def _watch(self) -> None:
        for name, (most, action) in self.watchdogs.items():
            if self.running and self.cycles - self.registers.written.get(name, self.cycles) > most:
                if action != "ignore":
                    self.end_program(f"watchdog: {name} was not written for {most} cycles")
                return

    def tell(self, text: str) -> None:
        """Keep a message, the beginning of a long one."""
        self.told += 1
        self.messages.append(f"{self.time:.3f} s: {text[:MOST_TEXT]}")

    def run_program(self, program: Program) -> None:
        """Start a script; one that runs ends, unless the new one is secondary."""
        if program.secondary:
            if len(self.beside) < MOST_BESIDE:
                self.beside.append(program)
            else:
                self.tell(f"{program.name}: not started, for {MOST_BESIDE} secondary programs run")
            return
        if self.program is not None:
            self.end_program("another program begins")
        if not self.safety.ready:
            self.tell(f"{program.name}: not started, for the robot is stopped")
            return
        self.watchdogs.clear()
        self.program = program
        self.tell(f"{program.name} begins")

    def end_program(self, why: str) -> None:
        """End the script that runs; the arm slows down."""
        if self.program is None:
            return
        program, self.program = self.program, None
        program.close()
        self.watchdogs.clear()
        self.tell(f"{program.name} ends: {why}")
        self.let_go()

    def let_go(self) -> None:
        """No command moves the arm any longer: it slows down."""
        if self.safety.ready and (self.motion is not None or not self.target.still):
            self.motion = Stop()

    def protective_stop(self, reason: str = "asked for") -> None:
        """Stop as the maker's controller does when a limit is passed; `unlock` leaves it."""
        self._stop(PROTECTIVE, f"protective stop: {reason}")

    def emergency_stop(self, reason: str = "the button is pressed") -> None:
        """Stop, and take the power away; `release_emergency_stop`, then power on and brake release leave it."""
        self._stop(EMERGENCY, f"emergency stop: {reason}")

    def _stop(self, mode: int, reason: str) -> None:
        if not self.safety.stop(mode, reason):
            return
        self.tell(reason)
        self.end_program(reason)
        self.motion = Stop(SAFE_DECELERATION)

    def unlock(self) -> bool:
        """Leave a protective stop; False where there is none, or the arm still moves."""
        return self.target.still and self.safety.release(PROTECTIVE)

    def release_emergency_stop(self) -> bool:
        """Pull the button out; False where it is not pressed. The power stays off."""
        return self.safety.release(EMERGENCY)

    def power_off(self) -> None:
        """Take the power from the arm: it stops, and its servo holds it as brakes would."""
        self.safety.power(POWER_OFF)
        self.end_program("the power is off")
        self.motion = Stop(SAFE_DECELERATION)

    def lose(self, samples: int) -> None:
        """Do not send the next samples."""
        self._to_lose = count("samples", samples)

    def load_script(self, text: str) -> None:
        """Run a script as if it had come by a socket. Raises `ScriptError` where it cannot be read."""
        from dmframe.virtual.program import Program

        self.run_program(Program(text, self))

    def listen(self, host: str = "127.0.0.1", ports: Ports | None = None) -> Ports:
        """Open ports, the maker's own without others; returns them. Raises `OutputError` where one is taken."""
        from dmframe.virtual.server import Ports, Servers

        self.close()
        self._servers = Servers(self, host, ports or Ports())
        return self._servers.ports

    def close(self) -> None:
        """End the script, and close all ports."""
        self.end_program("the robot is shut down")
        while self.beside:
            self.beside.pop().close()
        if self._servers is not None:
            self._servers.close()
            self._servers = None

    def __enter__(self) -> VirtualRobot:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def owing(self) -> list[Rtde]:
        """While a script runs, the clients by RTDE that answer samples, and have not answered the last."""
        return self._servers.owing if self._servers is not None and self.running else []

    def serve(self, wanted: Callable[[], bool] = lambda: True, patience: float = 0.0) -> None:
        """Run as long as it is wanted, in real time, or in step with a client; see `dmframe.virtual.pace`."""
        from dmframe.virtual.pace import serve

        serve(self, wanted, patience)

    def in_background(self, patience: float = 0.0) -> AbstractContextManager[VirtualRobot]:
        """Run, as by `serve`, in a thread of its own, until the block ends."""
        from dmframe.virtual.pace import in_background

        return in_background(self, patience)

    def wait(self, time: float) -> None:
        """Serve the ports for a while [s], no cycle passing."""
        from time import sleep

        if self._servers is None:
            sleep(time)
        else:
            self._servers.poll(time)
