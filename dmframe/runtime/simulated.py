"""Simulated robot: a graph's robot and servo without the controller, with a driver's interface."""

from __future__ import annotations

import copy
import ctypes
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.block.model import SYMBOLIC
from dmframe.block.port import Side
from dmframe.build.library import address
from dmframe.common.errors import DriveError, LostError
from dmframe.common.slices import slices
from dmframe.diagram import ClosedLoop, Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.runtime.robot import Sample
from dmframe.runtime.signals import FIELDS, measured_as, velocity_command
from dmframe.simulate.bounds import bounds_of
from dmframe.simulate.engine import Choice, Compiled, choose
from dmframe.simulate.instants import Instants
from dmframe.simulate.keep import Log
from dmframe.simulate.run import prepare
from dmframe.simulate.solver import Solver
from dmframe.simulate.start import start_state
from dmframe.simulate.step import plant_step
from dmframe.simulate.stiffness import speed_of

ARRIVED: Final = 1e-6
"""Tolerance of the end of a motion to a pose [rad]."""
SLOWEST: Final = 0.5
"""Largest fraction of the remaining distance that a motion to a pose covers in a period."""


@final
class SimulatedRobot:
    """Simulated robot; it does not run in real time.

    Without delay, jitter, lost samples or scaling its numbers equal those of `simulate` bit by bit, if both are
    compiled with the same options.

    Parameters
    ----------
    duration
        Expected duration [s], which decides between the compiled and the interpreted engine.
    delay
        Delay of commands [samples].
    lost
        Fraction of samples that are lost, at random by `seed`.
    jitter
        Largest deviation of a sampling instant from a perfect clock [s].
    scaling
        Factor of the commanded speeds, as of a speed slider.
    slowed_from
        Time from which `scaling` acts [s].
    payload
        Point mass at the tool that the controller does not model [kg].
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
            self.solver = whole.stepping(state, loop.p_values, speed_of(diagram, whole.slope, state)).solver
            shown = _shown(diagram, fields)
            commands = stack(leaf.symbol for leaf in loop.commanded)
            if any(ca.depends_on(expression, commands) for expression in shown.values()):
                raise DriveError("expected measurements that do not depend on the command, found one that does")
            size = state.size - stack(variable.symbol for variable in loop.plant).numel()
            own = Instants.of(loop, clock, seed, jitter)
            drawn = replace(own, drawn=(*own.drawn, *["uniform"] * commands.numel()))
            step = plant_step(loop, clock, self.solver, stack(shown.values()), bounds_of(diagram)[size:], drawn)
            columns = np.arange(step.parts.outputs.numel_out(0), dtype=np.int64) + (state.size - size)
            self._engine = choose(engine, step, self.solver, 1, columns, max(1, round(duration / clock)))
        self._parts = dict(zip(shown, slices(expression.numel() for expression in shown.values()), strict=True))
        self.period, self.engine, self._seed = clock, self._engine.name, seed
        self._start, self._p, self._step, self._size = state[size:].copy(), loop.p_values, step, commands.numel()
        self._columns = columns.size
        self._begin(delay, lost, scaling, slowed_from)

    def again(
        self, *, delay: int = 0, lost: float = 0.0, scaling: float = 1.0, slowed_from: float = 0.0
    ) -> SimulatedRobot:
        """The same robot at its start, with other options; its model is shared."""
        other = copy.copy(self)
        other._begin(delay, lost, scaling, slowed_from)
        return other

    def _begin(self, delay: int, lost: float, scaling: float, slowed_from: float) -> None:
        self.name = f"sim:{delay}" if delay else "sim"
        self._slowed, self._state = (slowed_from, scaling), self._start.copy()
        self._queue = deque([np.zeros(self._size) for _ in range(delay)])
        self._command, self._rows = np.zeros(self._size), np.zeros((1, self._columns))
        self._delay, self._lost, self._random = delay, lost, np.random.default_rng(self._seed)
        self._tick, self._started, self._fault = 0, False, ""

    @property
    def scaling(self) -> float:
        """Present speed scaling."""
        begin, scaling = self._slowed
        return scaling if self._tick * self.period >= begin else 1.0

    def connect(self) -> None:
        """See `Robot`."""

    def read(self) -> Sample:
        """See `Robot`; the first sample is at time 0."""
        missed = 0
        if self._started:
            self._advance()
            while self._lost and self._random.random() < self._lost:
                self._advance()
                missed += 1
        self._started = True
        return self._sample(missed)

    def begin(self) -> None:
        """See `Robot`; the next sample is at the same instant."""
        self._started = False

    def command(self, dq: np.ndarray) -> None:
        """See `Robot`."""
        self._command = np.array(dq, dtype=float)

    def move(self, q: np.ndarray, speed: float, acceleration: float, watched: Callable[[Sample], bool]) -> None:
        """See `Robot`; delays do not act on this motion."""
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
            # the largest speed from which it can still stop, and a fraction of the distance when it is near
            most = np.minimum(np.sqrt(2 * acceleration * np.abs(left) / 2), SLOWEST * np.abs(left) / T)
            wanted = np.sign(left) * np.minimum(speed, most)
            wanted[np.abs(left) < ARRIVED] = 0.0
            last = last + np.clip(wanted - last, -acceleration * T, acceleration * T)
            self._command = last / self.scaling if self.scaling else np.zeros(self._size)
            self._advance()
        else:
            raise LostError(f"{self.name}: the motion to the start did not end within 600 s of simulated time")
        self._command, self._queue = np.zeros(self._size), queue

    def stop(self, deceleration: float) -> None:
        """See `Robot`."""
        self._queue = deque()
        v = self._command * self.scaling
        for _ in range(round(600 / self.period)):
            if self._fault or not v.any():
                break
            v = np.sign(v) * np.maximum(np.abs(v) - deceleration * self.period, 0)
            self._command = v / self.scaling if self.scaling else np.zeros(self._size)
            self._advance()
        self._command = np.zeros(self._size)

    def close(self) -> None:
        """See `Robot`."""

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
        self._queue.append(self._command)
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
    """Expression of each field of a `Sample`: the controller's measurement, or the robot's signal."""
    found = {fields[leaf.name]: leaf.expression for leaf in diagram.loop.measured}
    for signal in diagram.loop.outputs:
        plant = diagram.blocks[signal.block].side is Side.PLANT
        if plant and signal.name in FIELDS and signal.name not in found:
            found[signal.name] = signal.expression
    lacking = [name for name in ("q", "dq") if name not in found]
    if lacking:
        raise DriveError(f"expected a robot with {' and '.join(lacking)}, found none in this graph")
    return {name: ca.densify(found[name]) for name in FIELDS if name in found}


def loaded(loop: ClosedLoop, payload: float) -> ClosedLoop:
    """Add a point mass [kg] at the tool to the last link.

    Raises
    ------
    DriveError
        The graph's robot has no masses.
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
