r"""Kinematic inverse of J: the reference controller ("rival") of a rehearsal.

It uses the robot's kinematics and the path, without a model of servo, masses and friction:

.. math:: \dot q_c = J^+ (\dot x_d - \gamma (x - x_d)), \quad \text{in joint space } \dot q_d - \gamma (q - q_d)

Its gain is the sensitivity of the rehearsed graph's velocity command to its goal, at least 1/s.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.block.model import SYMBOLIC
from dmframe.block.port import Side
from dmframe.common.units import plain
from dmframe.config import BaseGraph
from dmframe.diagram.closed_loop import Followed
from dmframe.results.metrics import goal_of, turn_of
from dmframe.robot.symbolic import kinematics
from dmframe.runtime.robot import Sample
from dmframe.simulate.start import start_state

LEAST_GAIN: Final = 1.0
"""Smallest gain of the rival [1/s]."""
LARGEST_GAIN: Final = 0.1
"""Largest fraction of the error that it removes in a sample, which limits the gain."""


@final
@dataclass(frozen=True, eq=False)
class Law:
    """Control law of a rival.

    Parameters
    ----------
    goal
        t -> s_d and its rate.
    shown
        q -> x, J; None in joint space.
    gain
        Gain gamma [1/s].
    """

    goal: Any
    shown: Any
    gain: float

    def __str__(self) -> str:
        kind = "kinematic inverse of J" if self.shown is not None else "kinematic command at the joints"
        return f"{kind}, {plain(self.gain, '1/s')}"


@final
class Rival:
    """Replaces the `ScaledController` controller of `dmframe.runtime.driving.drive` by a `Law`, which has no states."""

    def __init__(self, law: Law, n: int, clock: float) -> None:
        self.law, self.command = law, np.zeros(n)
        self.controller = SimpleNamespace(clock=clock, states={})
        self.lacking: tuple[str, ...] = ()

    def begin(self, sample: Sample, t: float = 0.0) -> None:
        """See `ScaledController`."""

    def step(self, sample: Sample, t: float, scale: float) -> bool:
        """See `ScaledController`."""
        law = self.law
        wanted, rate = (part.full().ravel() for part in law.goal(t))
        if law.shown is None:
            found = rate - law.gain * (sample.q - wanted)
        else:
            x, jacobian = (part.full() for part in law.shown(sample.q))
            error = (x.ravel() if sample.x is None else sample.x) - wanted
            found = np.linalg.pinv(jacobian) @ (rate - law.gain * error)
        self.command[:] = found
        return bool(np.isfinite(found).all())


def law_of(graph: BaseGraph) -> tuple[Law | None, str]:
    """Rival of a graph; None and the reason if none is applicable."""
    loop, goal, robot = graph.diagram.loop, goal_of(graph.diagram.loop), graph.diagram.robot
    if goal is None or robot is None:
        return None, "the graph does not follow a path of a robot"
    name, clock = goal.actual.split(".", 1)[1], graph.file.clock
    if turn_of(loop) is not None:
        return None, "the task includes an orientation"
    sizes = {"x": len(robot.axes), "q": robot.n}
    if name not in sizes or goal.wanted.numel() != sizes[name]:
        return None, f"it does not support a goal for {name}"
    with SYMBOLIC:
        wanted = loop.on_path(goal.wanted)
        if set(map(str, ca.symvar(wanted))) - set(map(str, ca.symvar(ca.veccat(loop.time, loop.p)))):
            return None, f"{goal.desired} is not a function of time only"
        at = ca.Function("goal", [loop.time, loop.p], [wanted, ca.jacobian(wanted, loop.time)])
        gain = max(LEAST_GAIN, min(_answer(graph, goal, name), LARGEST_GAIN / (clock or 1.0)))
        shown = kinematics(robot) if name == "x" else None
    p = loop.p_values
    return Law(lambda t: at(t, p), shown, gain), ""


def _answer(graph: BaseGraph, goal: Followed, name: str) -> float:
    """Mean sensitivity of the graph's first joint velocity signal to its goal, at the start [1/s]; 0 without one.

    For a goal in task space, it is the mean of the diagonal of J times the sensitivity.
    """
    diagram = graph.diagram
    loop, robot = diagram.loop, diagram.robot
    if not goal.wanted.is_valid_input():
        return 0.0
    state = start_state(diagram, graph.start)
    for signal in loop.outputs:
        if signal.unit != "rad/s" or diagram.blocks[signal.block].side is Side.PLANT or signal.shape != "n":
            continue
        change = ca.jacobian(signal.expression, goal.wanted)
        if not change.nnz():
            continue
        q = next((other.expression for other in loop.outputs if other.label.endswith(".q") and other.own), None)
        whole, angles = loop.joined([change, q if q is not None else ca.SX(robot.n, 1)])
        found = ca.Function(
            "answer", [loop.time, loop.state, loop.p, loop.period], [loop.on_path(whole), loop.on_path(angles)]
        )
        values, at = (part.full() for part in found(0, state, loop.p_values, graph.file.clock or 0))
        if name == "x":
            values = kinematics(robot)(at)[1].full() @ values
        mean = float(np.trace(values)) / len(values)
        return abs(mean) if np.isfinite(mean) else 0.0
    return 0.0
