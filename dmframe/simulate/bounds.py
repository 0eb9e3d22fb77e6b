"""Where a run is no longer one of a robot: it left the finite numbers, or went beyond any joint's speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from dmframe.diagram import Diagram, Variable
from dmframe.diagram.closed_loop import Signal
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


def beyond(
    diagram: Diagram, columns: Sequence[tuple[Variable | Signal, slice]], rows: np.ndarray, apart: float
) -> Divergence | None:
    """The first instant, of those kept `apart` [s], at which a state is larger than any of a robot's; None if none is.

    Joint velocities are held to `TIMES` the limits that the robot's file states, all states to `LARGEST`.
    """
    found: Divergence | None = None
    for item, part in columns:
        if not isinstance(item, Variable):
            continue
        bounds = _bounds(diagram, item, part.stop - part.start)
        values = np.abs(rows[:, part])
        if not values.size or not (values.max(axis=0) > bounds).any():
            continue
        wild = values > bounds
        row = int(np.argmax(wild.any(axis=1)))
        element = int(np.argmax(wild[row]))
        if found is None or row * apart < found.time:
            most = plain(float(bounds[element]), item.unit)
            what = f"is beyond {most}" + (f", {TIMES:g} times the joint's limit," if bounds[element] < LARGEST else "")
            found = Divergence(item.block, item.name, element, row * apart, what)
    return found


def _bounds(diagram: Diagram, variable: Variable, size: int) -> np.ndarray:
    """How large each element may get."""
    bounds = np.full(size, LARGEST)
    robot, side = diagram.robot, diagram.blocks[variable.block].side
    if robot is not None and side is Side.PLANT and variable.unit == "rad/s" and variable.shape == "n":
        limits = [TIMES * joint.velocity for joint in robot.joints]
        bounds = np.array([limit if math.isfinite(limit) and limit > 0 else LARGEST for limit in limits])
    return bounds
