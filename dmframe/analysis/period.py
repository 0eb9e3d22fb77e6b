"""Largest stable sampling period of the linearised loop and in simulation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, final

import numpy as np

from dmframe.analysis.linear import Linear, linearise
from dmframe.analysis.set_point import LARGE
from dmframe.common.errors import DmframeError, EngineError, ValueFault
from dmframe.common.units import plain
from dmframe.diagram import Diagram
from dmframe.simulate import Solver, simulate
from dmframe.simulate.solver import MOST_SUBSTEPS

SHORTEST, LONGEST = 1e-5, 10.0
"""Range of tested sampling periods [s]."""

GROWTH: Final = 2.0**0.25
TOLERANCE: Final = 1e-9
"""Tolerance of a spectral radius of 1."""

FACTOR: Final = 10.0
"""A simulated error is bounded if it stays below this times the largest one on a short clock."""

STEPS: Final = 5
"""Bisection steps of the search by simulation."""


@final
@dataclass(frozen=True)
class Bracket:
    """Stable at `stable` [s], unstable at `unstable` [s]; the boundary lies between.

    `stable` is 0 if no tested period is stable; `unstable` is infinite if all are.
    """

    stable: float
    unstable: float
    meaning: str


@final
@dataclass(frozen=True)
class StablePeriods:
    """Largest stable sampling period by three criteria.

    Parameters
    ----------
    at_rest
        Of the linearised loop, with the slope that smooth Coulomb friction has at rest, which damps it.
    moving
        Of the linearised loop without that slope; the shorter of the two is the one to design for.
    simulated
        Of the simulated run, whose estimates may not have converged.
    """

    at_rest: Bracket
    moving: Bracket
    simulated: Bracket


def largest_stable_period(
    diagram: Diagram,
    clock: float | None,
    *,
    solver: Solver | None = None,
    start: Mapping[str, Any] | None = None,
    horizon: float = 20.0,
) -> StablePeriods:
    """The largest sampling period up to which the loop stays stable, linearised and simulated.

    Parameters
    ----------
    clock
        Sampling period of the graph [s], start of the search by simulation; None for continuous time.
    horizon
        Duration of each simulation [s]; slower growth is not detected.

    Raises
    ------
    EngineError
        If there is no equilibrium or no goal. (A loop that is unstable for all periods is no fault.)
    """
    return StablePeriods(
        linearised_period(linearise(diagram, start=start, clock=clock)),
        linearised_period(linearise(diagram, start=start, moving=True, clock=clock)),
        simulated_period(diagram, clock, solver=solver, start=start, horizon=horizon),
    )


def sampled_radius(diagram: Diagram, clock: float, start: Mapping[str, Any] | None = None) -> float | None:
    """The larger spectral radius of the loop linearised on a clock [s], at rest or moving; None without a set-point.

    None also for loops with more than `LARGE` states, which would take longer than a run.
    """
    if diagram.loop.state.numel() > LARGE:
        return None
    try:
        at_rest = linearise(diagram, start=start, clock=clock)
        moving = linearise(diagram, at_rest.point, moving=True, clock=clock)
        return max(linear.spectral_radius(clock) for linear in (at_rest, moving))
    except DmframeError:
        return None


def linearised_period(linear: Linear) -> Bracket:
    """First period at which the spectral radius of the linearised sampled loop exceeds 1.

    Eigenvalues at 1 that correspond to 0 in continuous time are excluded: unexcited estimates have no unique
    equilibrium. A discrete-time loop may be unstable at shorter periods; if stable at its own period, the search starts
    there. A large loop is tested at its own period only.
    """
    meaning = (
        "spectral radius of the loop linearised at the set-point, Euler controller, exact zero-order hold, at most 1; "
        "for small motions about it, estimates near their true values"
    )

    def stable(period: float) -> bool:
        return linear.spectral_radius(period) <= 1 + TOLERANCE

    own = linear.clock
    if own is not None and len(linear.states) > LARGE:  # each period would take seconds
        return Bracket(own, float("inf"), meaning) if stable(own) else Bracket(0.0, own, meaning)
    lower, upper = _first_change(stable, own if own is not None and stable(own) else SHORTEST)
    for _ in range(40):
        if not (lower > 0 and np.isfinite(upper)) or upper - lower <= 1e-6 * upper:
            break
        middle = (lower + upper) / 2
        lower, upper = (middle, upper) if stable(middle) else (lower, middle)
    return Bracket(lower, upper, meaning)


def _first_change(stable: Callable[[float], bool], shortest: float) -> tuple[float, float]:
    """First neighbours on a geometric grid with a stable and an unstable period."""
    lower, period = 0.0, shortest
    while period <= LONGEST:
        if not stable(period):
            return lower, period
        lower, period = period, period * GROWTH
    return lower, float("inf")


def simulated_period(
    diagram: Diagram,
    clock: float | None,
    *,
    solver: Solver | None = None,
    start: Mapping[str, Any] | None = None,
    horizon: float = 20.0,
    tell: Callable[[str], None] = lambda _: None,
) -> Bracket:
    """Bisection over periods for a bounded error over the horizon; see `Bracket`.

    The bound is `FACTOR` times the largest error at the first period (of the graph, then halved) with a finite one. A
    run beyond the bound counts as unstable only if one with a quarter of the integrator step confirms it. `tell`
    receives progress messages.
    """
    if not (np.isfinite(horizon) and horizon > 0):
        raise ValueFault(f"horizon: expected a positive number of seconds, found {horizon}")
    if not diagram.loop.followed:
        raise EngineError("largest stable period: expected a goal to follow, such as x_d for x, found none")

    def error(period: float, taken: Solver) -> tuple[float, Solver]:
        if taken.step is not None:  # limit on the steps in a tick
            taken = replace(taken, step=max(taken.step, period / MOST_SUBSTEPS))
        tell(f"simulating {horizon:g} s with a period of {plain(period, 's')}")
        return _largest_error(diagram, period, taken, start, horizon)

    def finer(taken: Solver, period: float) -> Solver:
        return replace(taken, step=(taken.step or period) / 4)

    def bounded(period: float, bound: float) -> bool:
        found, taken = error(period, own)
        return found < bound or error(period, finer(taken, period))[0] < bound

    own = solver or Solver()
    period, reference = min(clock or 0.001, horizon / 8), np.inf
    while not np.isfinite(reference) and period >= SHORTEST * 10:
        reference, taken = error(period, own)
        if not np.isfinite(reference):
            reference, _ = error(period, finer(taken, period))
        period = period if np.isfinite(reference) else period / 2
    bound = FACTOR * max(reference, 1e-6) if np.isfinite(reference) else np.inf
    actual = diagram.loop.followed[0].actual
    unit = next(signal.unit for signal in diagram.loop.outputs if signal.label == actual)
    meaning = (
        f"simulated run of {horizon:g} s: the norm of its error stays below {plain(bound, unit)}, "
        f"{FACTOR:g} times its maximum at a period of {period * 1e3:.3g} ms; slower growth is not detected"
    )
    if not np.isfinite(reference):
        return Bracket(0.0, period * 2, f"no run of {horizon:g} s stays finite, down to the shortest tested period")
    lower, upper = period, period * 2
    while bounded(upper, bound):
        lower, upper = upper, upper * 2
        if upper > min(LONGEST, horizon / 8):
            return Bracket(lower, float("inf"), meaning)
    for _ in range(STEPS):
        middle = (lower + upper) / 2
        lower, upper = (middle, upper) if bounded(middle, bound) else (lower, middle)
    return Bracket(lower, upper, meaning)


def _largest_error(
    diagram: Diagram, period: float, solver: Solver, start: Mapping[str, Any] | None, horizon: float
) -> tuple[float, Solver]:
    """Largest norm of actual minus desired (infinite if diverged), and the solver used."""
    run = simulate(diagram, horizon, clock=period, solver=solver, start=start)
    if run.divergence is not None:
        return float("inf"), run.solver
    desired, actual, *_ = diagram.loop.followed[0]
    with np.errstate(over="ignore"):
        norms = np.linalg.norm(run[actual] - run[desired], axis=1)
    return float(np.max(norms)), run.solver
