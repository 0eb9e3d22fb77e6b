"""Controller of a diagram as a step function, for a real-time loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, final, get_args

import casadi as ca
import numpy as np

from dmframe.block.model import symbols_in
from dmframe.build import load
from dmframe.build.library import address, bound
from dmframe.build.trial import called
from dmframe.codegen import control_source
from dmframe.common.errors import EngineError, ValueFault, listed
from dmframe.common.slices import slices
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.pieces import Leaf
from dmframe.simulate.engine import Choice, alike
from dmframe.simulate.instants import Instants
from dmframe.simulate.start import start_state
from dmframe.simulate.start_expressions import measured_start


@final
class Controller:
    """Sampled controller of a diagram: maps measurements to commands.

    Plant blocks are not computed; they only determine initial states. A step equals that of `simulate`: commands from
    the present measurements, then the states one sample later (`ClosedLoop.advanced`), projected to their boxes. A step
    does not allocate memory: write to the arrays of `measured`, call `step`, read the arrays of `commanded`.

    A sample is refused if it, a command or a state after it is not finite. Commands and states then remain unchanged,
    and `refused` counts the sample.

    Parameters
    ----------
    clock
        Sampling period [s].
    start
        Initial values, as in `simulate`.
    engine
        ``auto`` compiles if a compiler is available; the attribute `engine` is the engine in use.

    Raises
    ------
    EngineError
        The diagram has no command, or ``compiled`` was requested and is not available.
    """

    def __init__(
        self, diagram: Diagram, clock: float, *, start: Mapping[str, Any] | None = None, engine: Choice = "auto"
    ) -> None:
        if not (math.isfinite(clock) and clock > 0):
            raise ValueFault(f"clock: expected a positive number of seconds, found {clock}", path=("clock",))
        if engine not in get_args(Choice):
            raise ValueFault(f"engine: expected {', '.join(get_args(Choice))}, found {engine!r}", path=("engine",))
        loop = diagram.loop
        ins, outs = loop.measured, loop.commanded
        if not outs:
            raise EngineError("controller: expected a diagram with a command, found no wire to a plant")
        function = control_function(diagram)
        size = function.numel_out(0)
        self._z, self._t, self._period = np.zeros(size), np.zeros(1), np.array([clock])
        self._p = np.ascontiguousarray(loop.p_values)
        # NaN until they are written, so that a missing signal is refused
        inside, outside = np.full(function.numel_in(1), np.nan), np.zeros(function.numel_out(1))
        self._start = start_state(diagram, start or {}, instants=Instants.of(loop, clock))[:size].copy()
        self.measured: Mapping[str, np.ndarray] = MappingProxyType(_parts(ins, inside))
        self.commanded: Mapping[str, np.ndarray] = MappingProxyType(_parts(outs, outside))
        self.states: Mapping[str, np.ndarray] = MappingProxyType(_parts(loop.controller, self._z))
        self._io = (inside, outside)  # the call reads and writes them by address
        self.diagram, self.given, self.clock = diagram, start or {}, clock
        call = None if engine == "interpreted" else self._machine_code(function)
        if call is None and engine == "compiled":
            raise EngineError("engine: expected a C compiler for the compiled engine, found none that works")
        self.engine = "interpreted" if call is None else "compiled"
        self._call = call or self._virtual_machine(function)
        self.reset()

    def step(self, t: float, period: float | None = None) -> bool:
        """Compute the commands at time t [s] and the states one period later; False if the sample is refused.

        `period` [s] is the time to the next sample if it is not the clock's, for example after a lost sample.
        """
        self._t[0] = t
        self._period[0] = self.clock if period is None else period
        if self._call():
            return True
        self.refused += 1
        return False

    def reset(self, *, measured: bool = False, t: float = 0.0) -> None:
        """Reset the states to their initial values, and `refused` to 0.

        With `measured`, states that start at the pose, such as an observer's, are initialised from the arrays of
        `measured` at time t [s]; estimates start as in the graph.

        Raises
        ------
        ValueFault
            A value of `measured` is not finite, or was not written.
        """
        if measured:
            given = self._io[0]
            if not (np.isfinite(given).all() and math.isfinite(t)):
                lacking = [name for name, array in self.measured.items() if not np.isfinite(array).all()] or ["t"]
                raise ValueFault(f"controller: expected finite measurements to start from, not {listed(lacking)}")
            self._z[:] = self._start_function(given, t, self.clock, self._p).full().ravel()
        else:
            self._z[:] = self._start
        self.refused = 0

    @cached_property
    def _start_function(self) -> Any:
        return start_function(self.diagram, self.given)[0]

    def _machine_code(self, function: Any) -> Callable[[], int] | None:
        try:
            source, constants = control_source(function)
        except EngineError:
            return None
        library = load(source, lambda library: _works(library, function, constants)).library
        if library is None:
            return None
        c = np.zeros(max(1, constants))
        library.dm_prepare(address(self._p), address(c))
        return bound(library.dm_tick, self._z, self._io[0], self._t, self._period, self._p, c, self._io[1])

    def _virtual_machine(self, function: Any) -> Callable[[], bool]:
        after, command = np.zeros(self._z.size), np.zeros(self._io[1].size)
        measured, t = self._io[0], self._t
        buffer, trigger = function.buffer()
        for k, array in enumerate((self._z, self._io[0], self._t, self._period, self._p)):
            buffer.set_arg(k, array.data)
        buffer.set_res(0, after.data)
        buffer.set_res(1, command.data)

        def call(kept: Any = (buffer, function)) -> bool:
            if not (np.isfinite(measured).all() and np.isfinite(t[0])):
                return False
            trigger()
            if not (np.isfinite(after).all() and np.isfinite(command).all()):
                return False
            np.copyto(self._z, after)
            np.copyto(self._io[1], command)
            return True

        return call


def _works(library: Path, function: Any, constants: int) -> bool:
    """Check a new library against the interpreter, at a random sample."""
    rng = np.random.default_rng(0)
    z, measured, p = (rng.uniform(0.5, 1.5, function.numel_in(place)) for place in (0, 1, 4))
    given = [{"doubles": array.tolist()} for array in (z, measured, np.array([0.3]), np.array([1e-3]), p)]
    prepared = called(library, "dm_prepare", [given[4], {"doubles": [0.0] * constants}])
    if prepared is None:
        return False
    sizes = function.numel_out(0), function.numel_out(1)
    found = called(library, "dm_tick", [*given, {"doubles": prepared[1]}, {"doubles": [0.0] * sizes[1]}])
    if found is None:
        return False
    after, commands = (part.full().ravel() for part in function(z, measured, 0.3, 1e-3, p))
    if not (np.isfinite(after).all() and np.isfinite(commands).all()):
        return bool(np.array_equal(found[0][: sizes[0]], z))  # refused
    mine = [found[0][: sizes[0]], found[6][: sizes[1]]]
    return alike(mine, lambda state: function(state, measured, 0.3, 1e-3, p), z)


def control_function(diagram: Diagram, *, path: bool = False) -> Any:
    """CasADi function (z, measured, t, T, p) -> (z one period later, commands).

    With `path`, the path is an additional last argument (`path_leaves`) instead of a function of time.
    """
    loop = diagram.loop
    expressions = _expressions(diagram)
    if not path:
        expressions = [loop.on_path(expression) for expression in expressions]
    for noise in loop.noises:
        if any(ca.depends_on(expression, noise.symbol) for expression in expressions):
            raise EngineError(f"controller: {noise.label} is random at each sample, which only a simulation supports")
    z, measured = loop.state[: expressions[0].numel()], stack(leaf.symbol for leaf in loop.measured)
    given = [stack(leaf.symbol for leaf in path_leaves(diagram))] if path else []
    return ca.Function("control", [z, measured, loop.time, loop.period, loop.p, *given], ca.cse(expressions))


def path_leaves(diagram: Diagram) -> tuple[Leaf, ...]:
    """Trajectories, present and future, that the controller reads."""
    loop, used = diagram.loop, symbols_in(_expressions(diagram))
    return tuple(leaf for leaf in (*loop.trajectories, *loop.ahead) if leaf.identities & used)


def _expressions(diagram: Diagram) -> list[Any]:
    """States of the controller one period later, and its commands, in terms of the path's symbols."""
    loop = diagram.loop
    size = stack(variable.symbol for variable in loop.controller).numel()
    commands = stack(leaf.expression for leaf in loop.commanded)
    advanced, commands = loop.projected([loop.advanced, commands], joined=False)
    return [loop.put_back(advanced)[:size], commands]


def path_function(diagram: Diagram) -> Any:
    """CasADi function (t, T, p) -> path argument of a `control_function`."""
    loop = diagram.loop
    path = stack(leaf.expression for leaf in path_leaves(diagram))
    return ca.Function("path", [loop.time, loop.period, loop.p], [ca.cse(path)])


def start_function(diagram: Diagram, given: Mapping[str, Any]) -> tuple[Any, tuple[str, ...]]:
    """CasADi function (measured, t, T, p) -> z, and the states that keep a simulation's initial values."""
    loop = diagram.loop
    z, unmeasured = measured_start(diagram, given)
    measured = stack(leaf.symbol for leaf in loop.measured)
    return ca.Function("start", [measured, loop.time, loop.period, loop.p], [ca.cse(ca.densify(z))]), unmeasured


def _parts(items: Any, array: np.ndarray) -> dict[str, np.ndarray]:
    labels = [getattr(item, "label", None) or item.name for item in items]
    parts = slices(item.symbol.numel() for item in items)
    return {label: array[part] for label, part in zip(labels, parts, strict=True)}
