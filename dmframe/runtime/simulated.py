"""A graph's own robot and servo, apart from their controller, behind the protocol of a driver."""

from __future__ import annotations

import ctypes
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.block.model import SYMBOLIC
from dmframe.build.library import address
from dmframe.diagram import ClosedLoop, Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.errors import DriveError, LostError
from dmframe.port import Side
from dmframe.runtime.robot import Sample
from dmframe.runtime.signals import TOLD, measured_as, velocity_command
from dmframe.simulate.bounds import bounds_of
from dmframe.simulate.engine import Choice, Compiled, choose
from dmframe.simulate.instants import Instants
from dmframe.simulate.keep import Log
from dmframe.simulate.run import prepare
from dmframe.simulate.start import start_state
from dmframe.simulate.step import Solver, plant_step
from dmframe.simulate.stiffness import speed_of

ARRIVED: Final = 1e-6
"""How near to a pose a move ends [rad]."""
SLOWEST: Final = 0.5
"""Of its way to a pose the simulated robot goes at most this share in a period, so that it comes to rest there."""


@final
class SimulatedRobot:
    """It answers at once: a second of its time takes as long as it takes to compute.

    Without delay, jitter, lost samples or scaling it has the very numbers of `simulate`, where both run with the same
    compiler options.

    Parameters
    ----------
    duration
        How long it is likely to run [s], which decides whether compiling is worth it.
    delay
        After how many samples a command acts.
    lost
        The share of its samples that do not arrive, at random by `seed`.
    jitter
        How much earlier or later than on a perfect clock a sample may be [s].
    scaling
        By how much it slows down what it is commanded, as a speed slider.
    slowed_from
        When that begins, by its clock [s].
    payload
        A point mass at its tool of which nobody has told the controller [kg].
    """

    def __init__(
        self,
        diagram: Diagram,
        clock: float,
        *,
        duration: float,
        start: Mapping[str, Any] | None = None,
        solver: Solver | None = None,
        seed: int = 0,
        jitter: float = 0.0,
        engine: Choice = "auto",
        delay: int = 0,
        lost: float = 0.0,
        scaling: float = 1.0,
        slowed_from: float = 0.0,
        payload: float = 0.0,
    ) -> None:
        fields, _ = measured_as(diagram), velocity_command(diagram)
        if payload:
            diagram = replace(diagram, loop=loaded(diagram.loop, payload))
        loop = diagram.loop
        with SYMBOLIC:
            whole = prepare(
                diagram, duration, clock=clock, solver=solver or Solver(), log=Log(), seed=seed, jitter=jitter
            )
            state = start_state(diagram, start or {}, whole.starts, whole.step.instants)
            self.solver = whole.stepping(
                state, loop.p_values, speed_of(diagram, whole.jacobian, state)
            ).solver  # as a simulation takes it
            shown = _shown(diagram, fields)
            commands = stack(leaf.symbol for leaf in loop.commanded)
            if any(ca.depends_on(expression, commands) for expression in shown.values()):
                raise DriveError("expected a robot that shows where it is, found one that shows what it is commanded")
            size = state.size - stack(variable.symbol for variable in loop.plant).numel()
            own = Instants.of(loop, clock, seed, jitter)
            drawn = replace(own, drawn=(*own.drawn, *["uniform"] * commands.numel()))
            step = plant_step(loop, clock, self.solver, stack(shown.values()), bounds_of(diagram)[size:], drawn)
            columns = np.arange(step.parts.outputs.numel_out(0), dtype=np.int64) + (state.size - size)
            self._engine = choose(engine, step, self.solver, 1, columns, max(1, round(duration / clock)))
        self._parts, first = dict[str, slice](), 0
        for name, expression in shown.items():
            self._parts[name] = slice(first, first + expression.numel())
            first += expression.numel()
        self.name = f"sim:{delay}" if delay else "sim"
        self.period, self._slowed = clock, (slowed_from, scaling)
        self.engine = self._engine.name
        self._state, self._p, self._step, self._size = state[size:].copy(), loop.p_values, step, commands.numel()
        self._queue = deque([np.zeros(self._size) for _ in range(delay)])
        self._held, self._rows = np.zeros(self._size), np.zeros((1, columns.size))
        self._delay, self._lost, self._random = delay, lost, np.random.default_rng(seed)
        self._tick, self._told, self._fault = 0, False, ""

    @property
    def scaling(self) -> float:
        """Of now, as a sample tells it."""
        begin, scaling = self._slowed
        return scaling if self._tick * self.period >= begin else 1.0

    def connect(self) -> None:
        """It is there."""

    def read(self) -> Sample:
        """The next sample. The first is that of time 0."""
        missed = 0
        if self._told:
            self._advance()
            while self._lost and self._random.random() < self._lost:
                self._advance()
                missed += 1
        self._told = True
        return self._sample(missed)

    def begin(self) -> None:
        """It takes no time: the next sample is that of the same instant."""
        self._told = False

    def command(self, dq: np.ndarray) -> None:
        """See `Robot`."""
        self._held = np.array(dq, dtype=float)

    def move(self, q: np.ndarray, speed: float, acceleration: float, watched: Callable[[Sample], bool]) -> None:
        """Its servo's target goes there; it does not wait for what is delayed."""
        queue, self._queue = self._queue, deque()
        last, T = np.zeros(self._size), self.period
        for _ in range(round(600 / T)):
            now = self._sample(0)
            if watched(now):
                self._queue = queue
                return
            left = q - (now.q_c if now.q_c is not None else now.q)
            if np.max(np.abs(left)) < ARRIVED and not last.any():
                break
            # as fast as it may and still come to rest, a share of the way at most where it is near
            most = np.minimum(np.sqrt(2 * acceleration * np.abs(left) / 2), SLOWEST * np.abs(left) / T)
            wanted = np.sign(left) * np.minimum(speed, most)
            wanted[np.abs(left) < ARRIVED] = 0.0
            last = last + np.clip(wanted - last, -acceleration * T, acceleration * T)
            self._held = last / self.scaling if self.scaling else np.zeros(self._size)
            self._advance()
        else:
            raise LostError(f"{self.name}: expected to arrive within 600 s of its time, and did not")
        self._held, self._queue = np.zeros(self._size), queue

    def stop(self, deceleration: float) -> None:
        """Its servo's target comes to rest."""
        self._queue = deque()
        v = self._held * self.scaling
        for _ in range(round(600 / self.period)):
            if self._fault or not v.any():
                break
            v = np.sign(v) * np.maximum(np.abs(v) - deceleration * self.period, 0)
            self._held = v / self.scaling if self.scaling else np.zeros(self._size)
            self._advance()
        self._held = np.zeros(self._size)

    def close(self) -> None:
        """Nothing is held."""

    def _sample(self, missed: int) -> Sample:
        row = self._given(np.zeros(self._size))
        if isinstance(self._engine, Compiled):
            self._call(row, 0)
            shown = self._rows[0].copy()
        else:
            shown = self._step.outputs(self._state, row, self._p).full().ravel()
        return Sample(
            time=float(row[0]),
            **{name: shown[part] for name, part in self._parts.items()},
            scaling=self.scaling,
            ready=not self._fault,
            fault=self._fault,
            age=self._delay * self.period,
            missed=missed,
        )

    def _given(self, commands: np.ndarray) -> np.ndarray:
        row: np.ndarray = self._step.instants.rows(self._tick, 1)[0]
        row[row.size - self._size :] = commands
        return row

    def _advance(self) -> None:
        self._queue.append(self._held)
        acting = self._queue.popleft()
        row = self._given(acting if self.scaling == 1 else acting * self.scaling)
        if isinstance(self._engine, Compiled):
            sound = self._call(row, 1) == 1
        else:
            self._state = self._step.tick(self._state, row, self._p)[0].full().ravel()
            sound = bool(np.all(np.abs(self._state) <= self._step.bounds))
        self._tick += 1
        if not sound:
            self._fault = "the simulated robot left its bounds"

    def _call(self, row: np.ndarray, ticks: int) -> int:
        engine, whole = self._engine, ctypes.c_int64
        assert isinstance(engine, Compiled)
        return int(
            engine.run(
                address(self._state),
                address(self._p),
                ctypes.c_double(self.period),
                whole(self._step.substeps),
                whole(0),
                whole(ticks),
                address(row),
                whole(1),
                address(engine.kept),
                whole(engine.kept.size),
                address(self._rows),
                address(self._step.bounds),
            )
        )


def _shown(diagram: Diagram, fields: Mapping[str, str]) -> dict[str, Any]:
    """For each field of a `Sample` its expression: what the controller measures, or else the robot's own."""
    found = {fields[leaf.name]: leaf.expression for leaf in diagram.loop.measured}
    for signal in diagram.loop.outputs:
        plant = diagram.blocks[signal.block].side is Side.PLANT
        if plant and signal.name in TOLD and signal.name not in found:
            found[signal.name] = signal.expression
    lacking = [name for name in ("q", "dq") if name not in found]
    if lacking:
        raise DriveError(f"expected a robot with {' and '.join(lacking)}, found none in this graph")
    return {name: ca.densify(found[name]) for name in TOLD if name in found}


def loaded(loop: ClosedLoop, payload: float) -> ClosedLoop:
    """The loop with a point mass [kg] at the tool, on the last link.

    Raises
    ------
    DriveError
        Its robot has no masses.
    """
    values = {parameter.label: parameter for parameter in loop.parameters}
    inertia, lengths = values.get("robot.inertia"), values.get("robot.a_k")
    if inertia is None or lengths is None:
        raise DriveError("payload: expected a graph with a robot from a file, found none")
    x, y, z = lengths.value.ravel()[-3:]
    # m, m r and m (|r|^2 I - r r'), in the order of `dmframe.robot.parameters.Inertial`
    point = np.array([1, x, y, z, y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
    value = inertia.value.copy()
    value.reshape(-1)[-10:] += payload * point
    changed = replace(inertia, value=value)
    return replace(loop, parameters=tuple(changed if item is inertia else item for item in loop.parameters))
