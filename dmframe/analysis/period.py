"""How slow may the clock be? The largest sampling period, on the linearised loop and by simulation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, final

import numpy as np

from dmframe.analysis.linear import Linear, linearise
from dmframe.analysis.set_point import LARGE
from dmframe.diagram import Diagram
from dmframe.errors import DmframeError, EngineError, ValueFault
from dmframe.simulate import Solver, simulate
from dmframe.simulate.step import MOST_SUBSTEPS
from dmframe.units import plain

SHORTEST, LONGEST = 1e-5, 10.0
"""Sampling periods that are looked at [s]."""

GROWTH: Final = 2.0**0.25
TOLERANCE: Final = 1e-9
"""A spectral radius is held to be at most 1 up to this."""

FACTOR: Final = 10.0
"""A simulated error is bounded if it stays below this times the largest one on a short clock."""

STEPS: Final = 5
"""Bisections of a bracket that a simulation leaves."""


@final
@dataclass(frozen=True)
class Bracket:
    """Stable at `stable` [s], unstable at `unstable` [s]; the boundary lies between.

    `stable` is 0 where no period is; `unstable` is infinite where every one looked at is stable.
    """

    stable: float
    unstable: float
    meaning: str


@final
@dataclass(frozen=True)
class StablePeriods:
    """The largest stable sampling period, three times; each answers a question of its own.

    Parameters
    ----------
    at_rest
        Of the linearised loop, with the slope that smooth Coulomb friction has at rest, which damps it.
    moving
        Of the linearised loop without that slope; the shorter of the two is the one to design for.
    simulated
        Of the graph's own run, which may not have learnt its estimates yet.
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
        The graph's clock [s], where the search by simulation begins; None for a continuous one.
    horizon
        How long each simulation lasts [s]; a slower growth is not seen.

    Raises
    ------
    EngineError
        No equilibrium, or no goal to follow. (A loop that no clock keeps bounded is no fault.)
    """
    return StablePeriods(
        linearised_period(linearise(diagram, start=start, clock=clock)),
        linearised_period(linearise(diagram, start=start, moving=True, clock=clock)),
        simulated_period(diagram, clock, solver=solver, start=start, horizon=horizon),
    )


def sampled_radius(diagram: Diagram, clock: float, start: Mapping[str, Any] | None = None) -> float | None:
    """The larger spectral radius of the loop linearised on a clock [s], at rest or moving; None without a set-point.

    None as well of a loop of so many states that it would take longer than a run.
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
    """Where the spectral radius of the linearised sampled loop first exceeds 1, as the period grows.

    Eigenvalues at 1 that the continuous loop has at 0 are left out: estimates that the set-point does not excite rest
    anywhere. A loop that runs on a clock alone may be stable on no shorter one: where it is stable on its own, the
    search begins there. A large one is looked at on its own clock alone.
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
    """The first pair of neighbours on a geometric grid, of which the longer period is unstable."""
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
    """Bisection over clocks for an error that stays bounded over the horizon; see `Bracket`.

    The bound is `FACTOR` times the largest error of a run on the first clock, from the graph's own on and halving, that
    gives a finite one. A run that leaves it counts only where one with a quarter of the integrator's step does so too.
    `tell` is called with what is done.
    """
    if not (np.isfinite(horizon) and horizon > 0):
        raise ValueFault(f"horizon: expected a positive number of seconds, found {horizon}")
    if not diagram.loop.followed:
        raise EngineError("largest stable period: expected a goal to follow, such as x_d for x, found none")

    def error(period: float, taken: Solver) -> tuple[float, Solver]:
        if taken.step is not None:  # no more steps than a tick may have
            taken = replace(taken, step=max(taken.step, period / MOST_SUBSTEPS))
        tell(f"simulating {horizon:g} s on a clock of {plain(period, 's')}")
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
        f"the graph's own run, {horizon:g} s long: the norm of its error stays below {plain(bound, unit)}, "
        f"{FACTOR:g} times its largest on a clock of {period * 1e3:.3g} ms; what grows more slowly is not seen"
    )
    if not np.isfinite(reference):
        return Bracket(0.0, period * 2, f"no run of {horizon:g} s stays finite, down to the shortest clock looked at")
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
    """The largest norm of actual minus desired, infinite for a run that diverges; and the solver that it took."""
    run = simulate(diagram, horizon, clock=period, solver=solver, start=start)
    if run.divergence is not None:
        return float("inf"), run.solver
    desired, actual, *_ = diagram.loop.followed[0]
    with np.errstate(over="ignore"):
        norms = np.linalg.norm(run[actual] - run[desired], axis=1)
    return float(np.max(norms)), run.solver
