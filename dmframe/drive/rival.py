r"""The kinematic inverse of J: the controller that a rehearsed one must not be worse than.

It knows the robot's kinematics and the path, and nothing of servo, masses and friction:

.. math:: \dot q_c = J^+ (\dot x_d - \gamma (x - x_d)), \quad \text{at the joints } \dot q_d - \gamma (q - q_d)

Its gain is that with which the rehearsed graph answers to its own goal; 1/s where that is less or cannot be seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.block.model import SYMBOLIC
from dmframe.config.experiment import Experiment
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import Followed
from dmframe.port import Side
from dmframe.results.metrics import goal_of, turn_of
from dmframe.robot.symbolic import SymbolicRobot
from dmframe.runtime.robot import Sample
from dmframe.simulate.start import start_state
from dmframe.units import plain

LEAST_GAIN: Final = 1.0
"""Of the rival [1/s]."""
MOST_SHARE: Final = 0.1
"""And at most this share of the error goes in a sample."""


@final
@dataclass(frozen=True, eq=False)
class Law:
    """What a rival computes.

    Parameters
    ----------
    goal
        t -> s_d, its rate.
    shown
        q -> x, J; None at the joints.
    gain
        [1/s].
    """

    goal: Any
    shown: Any
    gain: float

    def __str__(self) -> str:
        kind = "kinematic inverse of J" if self.shown is not None else "kinematic command at the joints"
        return f"{kind}, {plain(self.gain, '1/s')}"


@final
class Rival:
    """A `Law` in the place of a graph's controller, as `dmframe.runtime.driving.drive` runs one.

    Its time runs with the robot's scaling, as that of a `Steered`; it has no states. A step takes some 0.1 ms.
    """

    def __init__(self, law: Law, n: int, clock: float) -> None:
        self.law, self.command = law, np.zeros(n)
        self.controller = SimpleNamespace(clock=clock, states={})
        self.lacking: tuple[str, ...] = ()

    def begin(self, sample: Sample, t: float = 0.0) -> None:
        """It has nothing to begin with."""

    def step(self, sample: Sample, t: float, scale: float) -> bool:
        """Its command at its own time is then in `command`; False where it is not finite."""
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


def law_of(experiment: Experiment, diagram: Diagram) -> tuple[Law | None, str]:
    """The rival of a graph; None, and why, where there is no fair one."""
    loop, goal, robot = diagram.loop, goal_of(diagram.loop), diagram.robot
    if goal is None or robot is None:
        return None, "the graph follows no path of a robot"
    name, clock = goal.actual.split(".", 1)[1], experiment.file.clock
    if turn_of(loop) is not None:
        return None, "the task has an orientation, too"
    sizes = {"x": len(robot.axes), "q": robot.n}
    if name not in sizes or goal.wanted.numel() != sizes[name]:
        return None, f"it takes no goal for {name}"
    with SYMBOLIC:
        wanted = loop.on_path(goal.wanted)
        if set(map(str, ca.symvar(wanted))) - set(map(str, ca.symvar(ca.veccat(loop.time, loop.p)))):
            return None, f"{goal.desired} does not depend on time alone"
        at = ca.Function("goal", [loop.time, loop.p], [wanted, ca.jacobian(wanted, loop.time)])
        gain = max(LEAST_GAIN, min(_answer(experiment, diagram, goal, name), MOST_SHARE / (clock or 1.0)))
        shown = _kinematics(robot) if name == "x" else None
    p = loop.p_values
    return Law(lambda t: at(t, p), shown, gain), ""


def _kinematics(robot: Any) -> Any:
    symbolic, q = SymbolicRobot(robot), ca.SX.sym("q", robot.n)
    symbols = ca.veccat(*(constant.symbol for constant in symbolic.constants))
    values = ca.veccat(*map(ca.DM, symbolic.values().values()))
    found = ca.substitute([symbolic.position(q), symbolic.jacobian(q)], [symbols], [values])
    return ca.Function("kinematics", [q], found)


def _answer(experiment: Experiment, diagram: Diagram, goal: Followed, name: str) -> float:
    """How much the first velocity of joints that the graph makes of its goal changes with the goal, at the start [1/s].

    At the task it is seen in the task: the mean of the diagonal of J times the change. 0 where nothing is seen.
    """
    loop, robot = diagram.loop, diagram.robot
    if not goal.wanted.is_valid_input():
        return 0.0
    state = start_state(diagram, experiment.start)
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
        values, at = (part.full() for part in found(0, state, loop.p_values, experiment.file.clock or 0))
        if name == "x":
            values = _kinematics(robot)(at)[1].full() @ values
        mean = float(np.trace(values)) / len(values)
        return abs(mean) if np.isfinite(mean) else 0.0
    return 0.0
