"""Where a run is no longer one of a robot: it left the finite numbers, or went beyond any joint's speed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from dmframe.diagram import Diagram, Variable
from dmframe.errors import EngineError
from dmframe.port import Side
from dmframe.units import plain

TIMES: Final = 100.0
"""Of a joint's velocity limit: beyond it a run has blown up, though its numbers are finite still."""
LARGEST: Final = 1e10
"""Of any state that is kept, in its own unit."""


@final
@dataclass(frozen=True)
class Divergence:
    """Where a run blew up first, or moved too fast for the integrator: `how` says which."""

    block: str
    state: str
    element: int
    time: float
    how: str = "is no longer finite"

    def __str__(self) -> str:
        return f"{self.block}.{self.state}[{self.element}] {self.how} at t = {self.time:.6g} s"


def bounds_of(diagram: Diagram) -> np.ndarray:
    """How large each state may get, the controller's first, as one column.

    A joint's velocity: `TIMES` the limit that the robot's file states. Any other state: `LARGEST`.
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
    """Which state of those after a tick has left its bound; a number that is not finite goes before others."""
    wild = np.flatnonzero(~np.isfinite(state))
    row = int((wild if wild.size else np.flatnonzero(np.abs(state) > bounds))[0])
    variable, element = located(diagram, row)
    return Divergence(variable.block, variable.name, element, time, _how(bounds[row], variable, wild.size))


def located(diagram: Diagram, row: int) -> tuple[Variable, int]:
    """The state that a row of the loop's state belongs to, and its element there."""
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
