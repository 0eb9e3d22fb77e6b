"""Divergence of a run: non-finite states, or states beyond physical bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from dmframe.block.port import Side
from dmframe.common.errors import EngineError
from dmframe.common.units import plain
from dmframe.diagram import Diagram, Variable

TIMES: Final = 100.0
"""Multiple of a joint's velocity limit that counts as divergence."""
LARGEST: Final = 1e10
"""Bound of any other state, in its unit."""


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

    Joint velocities: `TIMES` the limit in the robot's file. Other states: `LARGEST`.
    """
    loop, robot = diagram.loop, diagram.robot
    parts = [np.zeros(0)]
    for variable in loop.variables:
        bounds = np.full(variable.symbol.numel(), LARGEST)
        plant = diagram.blocks[variable.block].side is Side.PLANT
        if robot is not None and plant and variable.unit == "rad/s" and variable.shape == "n":
            limits = [TIMES * joint.velocity for joint in robot.joints]
            bounds = np.array([limit if math.isfinite(limit) and limit > 0 else LARGEST for limit in limits])
        parts.append(bounds)
    return np.concatenate(parts)


def beyond(diagram: Diagram, state: np.ndarray, bounds: np.ndarray, time: float) -> Divergence:
    """First state beyond its bound after a tick; non-finite states take precedence."""
    infinite = np.flatnonzero(~np.isfinite(state))
    row = int((infinite if infinite.size else np.flatnonzero(np.abs(state) > bounds))[0])
    variable, element = located(diagram, row)
    return Divergence(variable.block, variable.name, element, time, _how(bounds[row], variable, infinite.size))


def located(diagram: Diagram, row: int) -> tuple[Variable, int]:
    """State variable and element of a row of the loop's state."""
    for variable in diagram.loop.variables:
        if row < variable.symbol.numel():
            return variable, row
        row -= variable.symbol.numel()
    raise EngineError("a state outside the diagram diverged")


def _how(bound: float, variable: Variable, infinite: int) -> str:
    if infinite:
        return Divergence.how
    limit = f", {TIMES:g} times the joint's limit," if bound < LARGEST else ""
    return f"is beyond {plain(float(bound), variable.unit)}{limit}"
