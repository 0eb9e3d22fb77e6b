"""Recorded signals of a simulation or a drive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np

from dmframe.diagram import Diagram
from dmframe.simulate.bounds import Divergence
from dmframe.simulate.instants import Instants
from dmframe.simulate.rank import Rank
from dmframe.simulate.solver import FIXED, Solver, substeps_of


@final
@dataclass(frozen=True)
class ExtraSignal:
    """Recorded signal that is not a signal of the diagram: one row an instant, or a number.

    Parameters
    ----------
    shape
        Shape in letters, as for a port.
    about
        Description.
    """

    values: np.ndarray
    shape: str
    unit: str
    about: str


@final
@dataclass(frozen=True)
class Estimate:
    """Estimated error of integration.

    Parameters
    ----------
    error
        Largest error of a joint position; infinite if a comparison diverged.
    unit
        ``rad``, ``m``, or ``rad, m`` for a robot with both kinds of joints.
    share
        Fraction of the run in which it was compared.
    """

    error: float
    unit: str
    share: float


@final
@dataclass(frozen=True, repr=False)
class Recording:
    """Recorded signals of a simulation, up to its end, divergence or interruption.

    Parameters
    ----------
    time
        (N,) [s].
    states, outputs
        By label ``block.name``: (N, rows) arrays.
    ranks
        Smallest singular values of the rank-monitored matrices.
    beside
        Additional signals such as ``robot.sent`` of a driven robot.
    drive
        Settings of a drive as JSON data (limits, ramp); empty for a simulation.
    start
        All states at the first instant, as one column; of a drive, those of the controller, with zeros for the plant's,
        and empty if not every sample was kept.
    instants
        Times and random numbers of the ticks; None for a drive.
    estimate
        Estimated error of integration; None if it was not estimated.
    """

    diagram: Diagram
    clock: float | None
    duration: float
    solver: Solver
    time: np.ndarray
    states: Mapping[str, np.ndarray]
    outputs: Mapping[str, np.ndarray]
    divergence: Divergence | None
    interrupted: bool
    wall_time: float
    engine: str
    notices: tuple[str, ...] = field(default=())
    ranks: tuple[Rank, ...] = field(default=())
    beside: Mapping[str, ExtraSignal] = field(default_factory=dict)
    drive: Mapping[str, Any] = field(default_factory=dict)
    start: np.ndarray = field(default_factory=lambda: np.zeros(0))
    instants: Instants | None = None
    estimate: Estimate | None = None

    @property
    def step(self) -> float | None:
        """Step of a fixed-step method in the longest tick [s]; None for another one."""
        if self.solver.method not in FIXED:
            return None
        period = self.clock if self.clock is not None else self.solver.output
        longest = period if self.instants is None else self.instants.longest
        return longest / substeps_of(longest, self.solver)

    @property
    def real_time_factor(self) -> float:
        """Simulated time over computing time."""
        return float(self.time[-1]) / self.wall_time if self.wall_time > 0 else float("inf")

    def __getitem__(self, label: str) -> np.ndarray:
        if label in self.beside:
            return self.beside[label].values
        return self.outputs[label] if label in self.outputs else self.states[label]

    def __repr__(self) -> str:
        return f"<Recording of {len(self.states) + len(self.outputs)} signals, {self.time.size} instants>"
