"""Settings of the integrator, and the number of its steps in a tick."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, Literal, final, get_args

from dmframe.common.errors import EngineError, ValueFault
from dmframe.common.units import plain

Method = Literal["rk4", "ros34pw2", "cvodes"]
"""Fixed-step fourth-order Runge-Kutta; a fixed-step Rosenbrock method of third order for stiff plants; SUNDIALS'
variable-step backward differentiation."""

FIXED: Final[tuple[Method, ...]] = ("rk4", "ros34pw2")
"""Fixed-step methods, which can be compiled."""

RK4_STABLE = 2.785
"""Classical RK4 is stable on the negative real axis for h |lambda| below this [Hairer1996]_."""

MOST_SUBSTEPS = 2000
"""Maximum fixed steps in a tick; the function of a tick contains all of them."""

MOST_TICKS = 10_000_000_000
"""Maximum number of ticks; hours of computation for a small loop."""

PLAIN_STEP = 0.001
"""Default maximum step of rk4 [s]."""

PLAIN_STEPS = {"rk4": PLAIN_STEP, "ros34pw2": PLAIN_STEP / 2}
"""Default maximum steps of fixed-step methods, for similar errors [s]."""


ACCURACY = 1e-5
"""Accuracy of a run whose graph states neither accuracy nor step [rad, m]."""


@final
@dataclass(frozen=True)
class Solver:
    """Integrator of the continuous-time part.

    Parameters
    ----------
    method
        ``rk4``, ``ros34pw2`` or ``cvodes``.
    step
        Maximum step of rk4 and ros34pw2 [s]; a tick is divided into equal steps. None: `PLAIN_STEP`, or shorter for
        a stiff plant.
    output
        Output interval in continuous time [s].
    tolerance
        Relative tolerance of cvodes; the absolute one is a thousandth of it.
    share
        Automatic steps of rk4 as a fraction of the largest stable step.
    accuracy
        Largest error of a joint position that the integrator may cause in a run [rad, m for prismatic joints]. Without
        `free` it only shortens automatic steps; with `step` the error is only estimated. None: no estimate.
    free
        Methods among which the accuracy decides, with steps that may be longer than the automatic ones.
    plain
        Longest automatic step [s]; by default that of `PLAIN_STEPS`.
    """

    method: Method = "rk4"
    step: float | None = None
    output: float = 0.01
    tolerance: float = 1e-9
    share: float = 0.8
    accuracy: float | None = None
    free: tuple[Method, ...] = ()
    plain: float | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        if self.method not in get_args(Method):
            *first, last = get_args(Method)
            raise ValueFault(f"solver.method: expected {', '.join(first)} or {last}, found {self.method!r}")
        for name in ("step", "output", "tolerance", "accuracy"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ValueFault(f"solver.{name}: expected a positive number, found {value}")
        if not 0 < self.share <= 1:
            raise ValueFault(f"solver.share: expected a number above 0, at most 1, found {self.share}")

        if self.accuracy is not None and self.method not in FIXED:
            raise ValueFault(
                f"solver.accuracy: expected solver.method {' or '.join(FIXED)}, found {self.method}, whose error "
                "follows from solver.tolerance; remove one of the two keys",
                path=("solver", "accuracy"),
            )

    @property
    def checked(self) -> Solver:
        """The same with the default accuracy, if it has none and a fixed-step method."""
        return replace(self, accuracy=ACCURACY) if self.accuracy is None and self.method in FIXED else self

    @property
    def automatic(self) -> Solver:
        """The same without an accuracy."""
        return replace(self, accuracy=None, free=())

    @property
    def takes(self) -> float:
        """Largest h |lambda| of automatic rk4 steps."""
        return self.share * RK4_STABLE


def substeps_of(clock: float | None, solver: Solver) -> int:
    """Integrator steps in a tick of `clock` [s]. Raises `EngineError` above `MOST_SUBSTEPS`."""
    if solver.method not in FIXED:
        return 1
    period = clock if clock is not None else solver.output
    if solver.step is None:
        longest = solver.plain or PLAIN_STEPS[solver.method]
        return min(MOST_SUBSTEPS, max(1, math.ceil(round(period / longest, 9))))
    steps = period / solver.step
    if steps > MOST_SUBSTEPS * (1 + 1e-9):
        tick, shorter = ("", "a shorter clock") if clock is not None else ("solver.output, ", "a shorter output")
        raise EngineError(
            f"solver.step: expected at most {MOST_SUBSTEPS} steps in a tick of {tick}{period:g} s, found {steps:.3g}; "
            f"take a longer step, {shorter}, or solver.method cvodes",
            path=("solver", "step"),
        )
    return max(1, math.ceil(round(steps, 9)))


def ticks_of(duration: float, clock: float | None, solver: Solver) -> int:
    """Number of ticks of a run; raises `ValueFault` and `EngineError` for invalid times."""
    for name, value in (("duration", duration), ("clock", clock)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise ValueFault(f"{name}: expected a positive number of seconds, found {value}", path=(name,))
    if clock is not None and clock > duration * (1 + 1e-9):
        raise ValueFault(
            f"clock: expected at most the simulated time, {plain(duration, 's')}, found {plain(clock, 's')}; take a "
            "faster clock, or run longer",
            path=("clock",),
        )
    substeps_of(clock, solver)
    ticks = duration / (clock if clock is not None else solver.output)
    if ticks > MOST_TICKS:
        slower = "a slower clock" if clock is not None else "a longer solver.output"
        raise EngineError(
            f"duration: a run of {ticks:.3g} ticks is too long, expected at most {MOST_TICKS:.3g}; "
            f"run a shorter time or take {slower}",
            path=("duration",),
        )
    return max(1, round(ticks))
