"""Stiffness of the plant, and step lengths for rk4."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dmframe.common.errors import EngineError
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.rosenbrock import ROS34PW2
from dmframe.simulate.solver import FIXED, RK4_STABLE, Solver
from dmframe.simulate.step import Step

RK4_STEPS = 10
"""Limit for rk4, as a multiple of its steps on a plant that is not stiff; above it ros34pw2 is selected, which takes
twice as many steps, each up to 2.2 times as expensive."""

EXPLICIT_TAKES = 0.5
"""Limit of `omitted_terms`: up to one half, these modes are stable and integrated with third order."""

MOST_SLOPE = 1e12
"""Limit of the Jacobian of the plant for all solvers [1/s or other units]."""


def speed_of(diagram: Diagram, slope: Any, state: np.ndarray) -> float:
    """Spectral radius of the plant's Jacobian at a state [1/s]; at rest the friction law is steepest.

    `slope` is the derivative of its rate in a direction.
    """
    size = stack(v.symbol for v in diagram.loop.flowing).numel()
    if not size:
        return 0.0
    columns = [slope(state, 0, diagram.loop.p_values, 0, row, 0, 0).full() for row in np.eye(state.size)[-size:]]
    return float(fastest(np.hstack(columns)[None])[0])


def fastest(jacobians: np.ndarray) -> np.ndarray:
    """(N,): spectral radii of N matrices; infinite above `MOST_SLOPE`."""
    speeds = np.full(len(jacobians), np.inf)
    tame = np.max(np.abs(jacobians), axis=(1, 2), initial=0.0) < MOST_SLOPE  # False for NaN
    speeds[tame] = np.max(np.abs(np.linalg.eigvals(jacobians[tame])), axis=1, initial=0.0)
    return speeds


def omitted_terms(step: Step, state: np.ndarray, p: np.ndarray) -> float:
    r"""Effect of the Jacobian terms that a linearly implicit method omits, per step.

    Spectral radius of :math:`(I - h \gamma A)^{-1} h (J - A)`, with step length h, Jacobian J and the approximation A
    that the method uses. Infinite if the linear systems are too large.
    """
    try:
        slopes, _ = step.parts.slopes, step.parts.implicit
    except EngineError:
        return math.inf
    if slopes.used is slopes.exact:
        return 0.0
    w, drawn = step.parts.trajectory(0, p), np.zeros(step.parts.sample.numel_in(2))
    z, u = step.parts.sample(state, w, drawn, step.period, p)
    used, exact = (f(state[z.numel() :], u, w, p).full() for f in slopes)
    if not np.all(np.isfinite(exact - used)):
        return math.inf
    try:
        system = np.eye(len(used)) - step.length * float(ROS34PW2.gamma) * used
        acting = np.linalg.solve(system, step.length * (exact - used))
    except np.linalg.LinAlgError:
        return math.inf
    return float(np.max(np.abs(np.linalg.eigvals(acting))))


def stiffness(step: Step, solver: Solver, speed: float, state: np.ndarray, p: np.ndarray) -> tuple[str, ...]:
    """Warning if a plant of that speed [1/s] is too stiff for a fixed-step method."""
    if solver.method not in FIXED:
        return ()
    h = step.length
    if math.isinf(speed):
        return (
            "the Jacobian of the plant at the initial state is not finite or exceeds 1e12; use parameters nearer to 1",
        )
    if solver.method == "ros34pw2" and omitted_terms(step, state, p) > EXPLICIT_TAKES:
        return (
            "the plant is stiff in terms that ros34pw2 integrates explicitly (products of states): set a shorter "
            "solver.step, or solver.method: cvodes",
        )
    if solver.method == "rk4" and h * speed > 0.9 * RK4_STABLE:
        return (
            f"the plant is stiff: at rest h |lambda| = {h * speed:.2f} for rk4 at {h * 1e3:.3g} ms, stable up to "
            f"{RK4_STABLE}; set solver.step: {solver.takes / speed * 1e3:.2g} ms, remove solver.step for an automatic "
            "step, or set solver.method: ros34pw2",
        )
    return ()
