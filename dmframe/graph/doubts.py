"""Notices that cannot be derived from a run: implausible times, a path out of reach, an unstable sampled loop."""

from __future__ import annotations

from typing import Final

from dmframe.block.model import SYMBOLIC
from dmframe.common.units import plain
from dmframe.config import BaseGraph
from dmframe.config.plausible import implausible
from dmframe.simulate import Recording

LONG: Final = 10.0
"""From this duration [s] on a run also checks the stability near the set-point, half a second for a UR10."""


def doubts(graph: BaseGraph, recording: Recording) -> tuple[str, ...]:
    """The notices about a run of the graph."""
    from dmframe.certify.reach import out_of_reach

    with SYMBOLIC:
        far = [f"{text}: no controller can track it there" for text in out_of_reach(graph.diagram, recording.duration)]
    left = (*implausible(graph), *far)
    if graph.clock is None or recording.divergence is not None or recording.duration < LONG:
        return left
    from dmframe.analysis.period import TOLERANCE, sampled_radius

    radius = sampled_radius(recording.diagram, graph.clock, graph.start)
    if radius is None or radius <= 1 + TOLERANCE:
        return left
    remark = (
        f"with its estimates at their true values this loop is unstable near its set-point with a clock of "
        f"{plain(graph.clock, 's')}, spectral radius {radius:.4g}: a longer run may diverge; `analyse` gives details"
    )
    return (*left, remark)
