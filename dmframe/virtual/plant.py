"""Plant of a virtual robot: the robot and the hidden servo of a graph, driven by joint velocity commands."""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Final, final

import casadi as ca
import numpy as np

from dmframe.build import load
from dmframe.build.library import address, bound
from dmframe.build.trial import called
from dmframe.codegen.function import ONE, written
from dmframe.codegen.source import shipped
from dmframe.common.errors import EngineError, ValueFault
from dmframe.common.slices import slices
from dmframe.config import BaseGraph
from dmframe.diagram.parts import split
from dmframe.export.program import Member
from dmframe.export.robot import Robot, robot_of
from dmframe.simulate.engine import Choice

FINEST: Final = 1e-9
"""Relative tolerance for a cycle that is a whole number of the graph's steps."""


@final
class Plant:
    """Joints, their friction, and the servo that turns velocity commands into torque.

    It integrates with the steps of the graph's simulation if a cycle is a whole number of them, else with shorter ones.

    Parameters
    ----------
    cycle
        Time between two commands [s].
    engine
        As in `simulate`.

    Attributes
    ----------
    q, dq : (n,), rad and rad/s
        Measured values; `move` writes to these arrays.
    steps, step
        Number of RK4 steps in a cycle, and their length [s].

    Raises
    ------
    EngineError
        The graph's robot cannot be separated from the controller (see `robot_of`), its command is not a joint
        velocity, or it does not measure q and dq.
    """

    def __init__(self, graph: BaseGraph, cycle: float, *, engine: Choice = "auto") -> None:
        if not (math.isfinite(cycle) and cycle > 0):
            raise ValueFault(f"cycle: expected a positive number of seconds, found {cycle}")
        robot = robot_of(graph)
        _check_commands(graph.name, robot)
        own = robot.period / robot.substeps
        self.steps = max(1, math.ceil(cycle / own - FINEST))
        self.step = cycle / self.steps
        self._start = np.array([number for member in robot.states for number in member.value])
        self._x = self._start.copy()
        self._p = np.array([n for member in robot.parameters for n in member.value] or [0.0])
        shown = np.zeros(sum(member.size for member in robot.measured))
        places = _places(robot.measured)
        for name in ("q", "dq"):
            if name not in places:
                raise EngineError(f"{graph.name}: expected a robot that measures {name}, found {', '.join(places)}")
        self._shown, self.q, self.dq = shown, shown[places["q"]], shown[places["dq"]]
        self._u, self._robot = np.zeros(robot.commanded[0].size), robot
        calls = None if engine == "interpreted" else self._machine_code()
        if calls is None and engine == "compiled":
            raise EngineError("engine: expected a C compiler for the compiled engine, found none that works")
        self.engine = "interpreted" if calls is None else "compiled"
        self._move, self._show = calls or (self._move_by_casadi, self._show_by_casadi)
        self._show()

    @property
    def torque(self) -> np.ndarray:
        """Motor torques at the joints with the last command, K u [N m]; NaN if the graph does not have them."""
        if self._robot.torque is None:
            return np.full(self.n, np.nan)
        found: np.ndarray = self._robot.torque(self._x, self._u, self._p).full().ravel()
        return found

    @property
    def n(self) -> int:
        """Number of joints."""
        return self._u.size

    def move(self, dq_c: np.ndarray) -> bool:
        """Integrate one cycle with a constant velocity command [rad/s]; False, without a change, if not finite."""
        self._u[:] = dq_c
        if not self._move():
            return False
        self._show()
        return True

    def reset(self) -> None:
        """Reset the state to the graph's initial state."""
        self._x[:] = self._start
        self._show()

    def _machine_code(self) -> tuple[Callable[[], int], Callable[[], object]] | None:
        x, u, p = (ca.SX.sym(word, self._robot.rate.numel_in(k)) for k, word in enumerate(("x", "u", "p")))
        rate, shown = self._robot.rate(x, u, p), self._robot.shown(x, p)
        made, constants = split({"rate": ([x, u], [rate]), "measured": ([x], [shown])}, p)
        try:
            functions = [written(function, ONE) for function in (constants, *made)]
        except EngineError:
            return None
        source = "\n".join(
            [
                *map(shipped, ONE.arithmetic),
                f"#define DM_X {x.numel()}",
                '#define DM_EXPORT __attribute__((visibility("default")))',
                *functions,
                files("dmframe.virtual").joinpath("plant.c").read_text(encoding="utf-8"),
            ]
        )
        count = constants.numel_out(0)
        library = load(source, lambda library: self._works(library, count)).library
        if library is None:
            return None
        c, steps = np.zeros(max(1, count)), np.array([self.step, float(self.steps)])
        library.dm_prepare(address(self._p), address(c))
        move = bound(library.dm_move, self._x, self._u, steps, steps[1:], self._p, c)
        return move, bound(library.dm_show, self._x, self._p, c, self._shown)

    def _works(self, library: Path, constants: int) -> bool:
        """Check a new library against the interpreter, near the initial state."""
        rng = np.random.default_rng(0)
        x = self._start + rng.uniform(-0.01, 0.01, self._start.size)
        u = rng.uniform(-0.1, 0.1, self._u.size)
        p = {"doubles": self._p.tolist()}
        prepared = called(library, "dm_prepare", [p, {"doubles": [0.0] * constants}])
        if prepared is None:
            return False
        c = {"doubles": prepared[1]}
        steps = [{"doubles": [self.step]}, {"doubles": [float(self.steps)]}]
        found = called(library, "dm_move", [{"doubles": x.tolist()}, {"doubles": u.tolist()}, *steps, p, c])
        seen = called(library, "dm_show", [{"doubles": x.tolist()}, p, c, {"doubles": self._shown.tolist()}])
        if found is None or seen is None:
            return False
        expected, shown = self._after(x, u), self._robot.shown(x, self._p).full().ravel()
        pairs = ((found[0], expected), (seen[3], shown))
        return all(np.allclose(mine, theirs, rtol=1e-6, atol=1e-9) for mine, theirs in pairs)

    def _after(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        h, p = self.step, self._p

        def rate(at: np.ndarray) -> np.ndarray:
            slope: np.ndarray = self._robot.rate(at, u, p).full().ravel()
            return slope

        for _ in range(self.steps):
            k1 = rate(x)
            k2 = rate(x + h / 2 * k1)
            k3 = rate(x + h / 2 * k2)
            k4 = rate(x + h * k3)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return x

    def _move_by_casadi(self) -> bool:
        after = self._after(self._x, self._u)
        if not np.isfinite(after).all():
            return False
        self._x[:] = after
        return True

    def _show_by_casadi(self) -> None:
        self._shown[:] = self._robot.shown(self._x, self._p).full().ravel()


def _places(members: tuple[Member, ...]) -> dict[str, slice]:
    """Slice of each port in the vector of all measured values, by port name."""
    names = (member.label.rpartition(".")[2] for member in members)
    return dict(zip(names, slices(member.size for member in members), strict=True))


def _check_commands(name: str, robot: Robot) -> None:
    if [member.unit for member in robot.commanded] != ["rad/s"]:
        commands = " and ".join(f"{member.label} [{member.unit}]" for member in robot.commanded)
        raise EngineError(f"{name}: expected joint velocity commands in rad/s, as for speedj of a UR; found {commands}")
