"""A candidate of tuning: its graphs, the checks before any run, and its runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, final

import numpy as np

from dmframe.analysis.period import TOLERANCE, sampled_radius
from dmframe.batch.columns import Columns
from dmframe.block.model import SYMBOLIC
from dmframe.certify.checked import Checked, Numbers
from dmframe.certify.claim import Claim, NotApplicableError, claim_of
from dmframe.certify.conditions import conditions_of
from dmframe.certify.over import over_intervals
from dmframe.common.errors import DmframeError, NeedsDiagramError, ValueFault
from dmframe.diagram import Diagram
from dmframe.diagram.values import with_values
from dmframe.exact.rational import Interval
from dmframe.graph.graph import Graph
from dmframe.robot.rational import decimal
from dmframe.study.box import box_of, has_bounds, hull
from dmframe.study.grid import changed, given_of
from dmframe.study.objective import CONDITIONS, EVERYWHERE
from dmframe.study.plan import Study
from dmframe.study.varied import Factor

DIGITS: Final = 5
"""Significant digits of a tried value; more would be noise in the resulting graph."""


def rounded(value: float, lower: float, upper: float) -> float:
    """A value rounded to `DIGITS`, within its bounds."""
    return min(max(float(f"{value:.{DIGITS - 1}e}"), lower), upper)


def with_tuned(study: Study, factors: Sequence[Factor], values: Mapping[str, float]) -> Study:
    """The study with tuned parameters in its graphs, on the closed loops that are ready.

    Raises
    ------
    DmframeError
        A graph has no such parameter, or the value is not allowed.
    """
    bases = dict[str, Graph]()
    for name, base in study.bases.items():
        found = dict[str, np.ndarray]()
        for factor in factors:
            factor.put(found, np.array([[values[column] for column in factor.columns]]), base)
        bases[name] = changed(base, given_of(found, "tune"))
    return study.altered(bases=bases)


@final
@dataclass
class Proofs:
    """Conditions of the graphs' proofs at a candidate's numbers; claims that do not depend on them are cached."""

    claims: dict[int, Claim] = field(default_factory=dict)

    def failing(self, study: Study, point: int, *, everywhere: bool) -> list[Checked]:
        """Conditions that do not hold at a point of the grid, or, with `everywhere`, in the box of the samples.

        Raises
        ------
        ValueFault
            The graph has no certificate to prove.
        """
        graph = study.points[point].graph
        with SYMBOLIC:
            claim = self._claim(study, graph)
            box = _intervals(study, graph, claim.diagram) if everywhere else {}
            numbers = Numbers(claim, box)
            try:
                checked, _ = conditions_of(claim, numbers, graph.start)
                checked = over_intervals(checked, claim, numbers)
            except NotApplicableError as error:
                raise _no_claim(graph, error.text) from None
        return [item for item in checked if not item.holds]

    def _claim(self, study: Study, graph: Graph) -> Claim:
        diagram, numbers = study.runner.loop_of(graph)
        try:
            claim = self.claims.get(id(diagram.resolver))
            if claim is None:
                claim = self.claims[id(diagram.resolver)] = claim_of(diagram)
            varied = with_values(diagram, numbers)
            return replace(claim, diagram=varied, loop=varied.loop)
        except NeedsDiagramError:
            return claim_of(graph.diagram)
        except NotApplicableError as error:
            raise _no_claim(graph, error.text) from None


def _no_claim(graph: Graph, why: str) -> DmframeError:
    return ValueFault(
        f"tune.subject_to: {graph.name} has no certificate whose conditions could be checked: {why}; remove "
        f"{CONDITIONS}, subject_to: []",
        path=("tune", "subject_to"),
    )


def _intervals(study: Study, graph: Graph, diagram: Diagram) -> dict[str, Sequence[Interval]]:
    """Intervals of the sampled parameters that contain the graph's own values too."""
    for factor in study.factors:
        if factor.spread is not None and not has_bounds(factor.spread):
            raise ValueFault(f"sample.{factor.name}: {EVERYWHERE} needs bounds; clip: [lower, upper] sets them")
    own = {
        item.label: [Interval(decimal(x), decimal(x)) for x in item.value.ravel(order="F").tolist()]
        for item in diagram.loop.parameters
    }
    drawn = {
        label: found for label, found in box_of(diagram, study.factors, graph.start).intervals.items() if label in own
    }
    return hull(drawn, {label: own[label] for label in drawn})


def violation(failing: Sequence[Checked]) -> float:
    """Degree of violation: the number of failing conditions, plus a fraction for the worst margin."""
    margins = [item.value for item in failing if item.value is not None and math.isfinite(item.value)]
    lack = max((abs(min(value, 0.0)) for value in margins), default=0.0)
    return len(failing) + lack / (1 + lack) if failing else 0.0


def unstable(study: Study, point: int, period: float) -> float | None:
    """Spectral radius of the linearised loop minus 1, at a period [s] and its halves.

    Down to the graph's own clock. At most zero if the loop is stable at all of them; None if no set-point was found.
    """
    graph = study.points[point].graph
    diagram, numbers = study.runner.loop_of(graph)
    varied, worst = with_values(diagram, numbers), -math.inf
    own = graph.file.clock or period
    while True:
        radius = sampled_radius(varied, period, graph.start)
        if radius is None:
            return None
        worst = max(worst, radius - 1)
        if period <= own:
            return worst - TOLERANCE
        period = max(period / 2, own)


def rows_of_runs(study: Study, runs: Sequence[int], threads: int) -> Columns:
    """The table of some runs of a study, by number, in their order."""
    points, wanted = len(study.points), np.array(runs, dtype=np.int64)
    several = [(point, wanted[wanted % points == point] // points) for point in range(points)]
    table = study.rows_at([(point, samples) for point, samples in several if samples.size], threads)
    order = np.argsort(table["run"])[np.searchsorted(np.sort(table["run"]), wanted)].tolist()
    return {name: [column[place] for place in order] for name, column in table.items()}
