"""How fast the plant moves by itself, and the steps that rk4 may then take."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.simulate.step import RK4_STABLE, Solver, Step

RK4_TAKES = 0.8 * RK4_STABLE
"""h |lambda| of the steps that are chosen for rk4."""

MOST_SLOPE = 1e12
"""No solver takes a plant whose rates change faster [1/s, or its other units]."""


def speed_of(diagram: Diagram, slope: Any, state: np.ndarray) -> float:
    """The largest modulus of an eigenvalue of the plant at a state [1/s]; at rest the friction law is steepest."""
    size = stack(v.symbol for v in diagram.loop.flowing).numel()
    if not size:
        return 0.0
    return float(fastest(slope(state, 0, diagram.loop.p_values, 0)[0].full()[None, :, -size:])[0])


def fastest(jacobians: np.ndarray) -> np.ndarray:
    """(N,): the largest modulus of an eigenvalue of each of N matrices; infinite where one is too steep for it."""
    speeds = np.full(len(jacobians), np.inf)
    tame = np.max(np.abs(jacobians), axis=(1, 2), initial=0.0) < MOST_SLOPE  # nan is not
    speeds[tame] = np.max(np.abs(np.linalg.eigvals(jacobians[tame])), axis=1, initial=0.0)
    return speeds


def stiffness(step: Step, solver: Solver, speed: float) -> tuple[str, ...]:
    """A notice where a plant of that speed [1/s] is too stiff for a fixed-step method."""
    if solver.method != "rk4":
        return ()
    h = step.period / step.substeps
    if math.isinf(speed):
        return ("at the start the plant's rates are too steep to compute with; take parameters nearer to 1",)
    if h * speed > 0.9 * RK4_STABLE:
        return (
            f"the plant is stiff: at rest h |lambda| = {h * speed:.2f} for rk4 at {h * 1e3:.3g} ms, stable up to "
            f"{RK4_STABLE}; take solver.step: {RK4_TAKES / speed * 1e3:.2g} ms, leave it out, or take "
            "solver.method: cvodes",
        )
    return ()
