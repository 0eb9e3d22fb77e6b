"""Divergence of a run: non-finite states, or states beyond physical bounds.

Errors that grow while all states stay within their bounds: `dmframe.simulate.growth`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from dmframe.block.port import Side
from dmframe.common.errors import EngineError
from dmframe.common.units import plain
from dmframe.diagram import Diagram, Variable

TIMES: Final = 100.0
"""Multiple of a joint's velocity limit that counts as divergence."""
LARGEST: Final = 1e10
"""Bound of any other state, in its unit."""
POSITION: Final = "q"
"""Name of the plant state with the joint positions."""


@final
@dataclass(frozen=True)
class Divergence:
    """First divergence of a run, or failure of the integrator, as described by `how`."""

    block: str
    state: str
    element: int
    time: float
    how: str = "is no longer finite"

    def __str__(self) -> str:
        return f"{self.block}.{self.state}[{self.element}] {self.how} at t = {self.time:.6g} s"


def bounds_of(diagram: Diagram) -> np.ndarray:
    """Bounds of all states, the controller's first, as one column.

    Joint positions: the limits in the robot's file, and beyond them once more the whole range; a joint without limits
    has no such bound. Joint velocities: `TIMES` the limit. Other states: `LARGEST`.
    """
    loop = diagram.loop
    parts = [np.zeros(0)]
    for variable in loop.variables:
        limits = np.full(variable.symbol.numel(), LARGEST)
        if is_position(diagram, variable):
            lower, upper = ranges(diagram.robot)
            limits = np.maximum(np.abs(lower), np.abs(upper)) + upper - lower
        elif diagram.robot is not None and _of_joints(diagram, variable, "rad/s"):
            limits = np.array([TIMES * joint.velocity for joint in diagram.robot.joints])
        parts.append(np.where(np.isfinite(limits) & (limits > 0), limits, LARGEST))
    return np.concatenate(parts)


def is_position(diagram: Diagram, variable: Variable) -> bool:
    """True for the joint positions of the robot."""
    return diagram.robot is not None and variable.name == POSITION and _of_joints(diagram, variable, "rad")


def ranges(robot: Any) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper limits of the joints, infinite where the file has none or two equal ones."""
    limits = [(joint.lower, joint.upper) for joint in robot.joints]
    lower, upper = np.array([pair if pair[0] < pair[1] else (-math.inf, math.inf) for pair in limits]).T
    return lower, upper


def _of_joints(diagram: Diagram, variable: Variable, unit: str) -> bool:
    plant = diagram.blocks[variable.block].side is Side.PLANT
    return plant and variable.unit == unit and variable.shape == "n"


def beyond(diagram: Diagram, state: np.ndarray, bounds: np.ndarray, time: float) -> Divergence:
    """First state beyond its bound after a tick; non-finite states take precedence."""
    infinite = np.flatnonzero(~np.isfinite(state))
    row = int((infinite if infinite.size else np.flatnonzero(np.abs(state) > bounds))[0])
    variable, element = located(diagram, row)
    how = Divergence.how if infinite.size else _how(diagram, variable, float(bounds[row]))
    return Divergence(variable.block, variable.name, element, time, how)


def located(diagram: Diagram, row: int) -> tuple[Variable, int]:
    """State variable and element of a row of the loop's state."""
    for variable in diagram.loop.variables:
        if row < variable.symbol.numel():
            return variable, row
        row -= variable.symbol.numel()
    raise EngineError("a state outside the diagram diverged")


def _how(diagram: Diagram, variable: Variable, bound: float) -> str:
    """As in `solver.js`."""
    far = "farther outside of the joint's limits than they are apart"
    how = far if is_position(diagram, variable) else f"{TIMES:g} times the joint's limit"
    return f"is beyond {plain(bound, variable.unit)}" + (f", {how}," if bound < LARGEST else "")
