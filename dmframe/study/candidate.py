"""One set of values that tuning tries: its graphs, what is asked of it before any run, and its runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final, final

import numpy as np

from dmframe.analysis.period import TOLERANCE, sampled_radius
from dmframe.block.model import SYMBOLIC
from dmframe.certify.checked import Checked, Numbers
from dmframe.certify.claim import Claim, NotApplicableError, claim_of
from dmframe.certify.conditions import conditions_of
from dmframe.certify.over import over_intervals
from dmframe.config.experiment import Experiment
from dmframe.config.given import node_of
from dmframe.diagram import Diagram
from dmframe.diagram.values import with_values
from dmframe.errors import DmframeError, NeedsDiagramError, ValueFault
from dmframe.exact.rational import Interval
from dmframe.robot.rational import decimal
from dmframe.study.grid import Given, changed
from dmframe.study.objective import CONDITIONS, EVERYWHERE
from dmframe.study.plan import Study
from dmframe.study.varied import Factor

DIGITS: Final = 5
"""Significant digits of a value that is tried: more would only be noise in the graph that comes out."""


def rounded(value: float, lower: float, upper: float) -> float:
    """A value as it is tried."""
    return min(max(float(f"{value:.{DIGITS - 1}e}"), lower), upper)


def with_tuned(study: Study, factors: Sequence[Factor], values: Mapping[str, float]) -> Study:
    """The study with its graphs' parameters tuned, on the closed loops that the study has ready.

    Raises
    ------
    DmframeError
        A graph that has no such parameter, or cannot take the value.
    """
    said, bases = "tune", dict[str, Experiment]()
    for name, base in study.bases.items():
        held = dict[str, np.ndarray]()
        for factor in factors:
            factor.put(held, np.array([[values[column] for column in factor.columns]]), base)
        sets = [Given(label, node_of(rows[0].tolist(), (label,), said), said) for label, rows in held.items()]
        bases[name] = changed(base, sets)
    return study.on(bases)


@final
@dataclass
class Proofs:
    """The conditions of the graphs' proofs, at any candidate's numbers; what does not depend on them is kept."""

    claims: dict[int, Claim] = field(default_factory=dict)

    def failing(self, study: Study, point: int, *, everywhere: bool) -> list[Checked]:
        """Conditions that do not hold at a point of the grid; with `everywhere`, over all that is sampled there.

        Raises
        ------
        ValueFault
            The graph claims nothing that could be proved.
        """
        experiment = study.points[point].graph.experiment
        with SYMBOLIC:
            claim = self._claim(study, experiment)
            box = _intervals(study, point, claim.diagram) if everywhere else {}
            numbers = Numbers(claim, box)
            try:
                checked, _ = conditions_of(claim, numbers, experiment.start)
                checked = over_intervals(checked, claim, numbers)
            except NotApplicableError as error:
                raise _no_claim(experiment, error.text) from None
        return [item for item in checked if not item.holds]

    def _claim(self, study: Study, experiment: Experiment) -> Claim:
        diagram, numbers = study.loop_of(experiment)
        try:
            claim = self.claims.get(id(diagram.resolver))
            if claim is None:
                claim = self.claims[id(diagram.resolver)] = claim_of(diagram, near=True)
            varied = with_values(diagram, numbers)
            return replace(claim, diagram=varied, loop=varied.loop)
        except NeedsDiagramError:
            return claim_of(experiment.diagram(), near=True)
        except NotApplicableError as error:
            raise _no_claim(experiment, error.text) from None


def _no_claim(experiment: Experiment, why: str) -> DmframeError:
    return ValueFault(
        f"tune.subject_to: {experiment.name} has no proof whose conditions could be asked for: {why}; leave "
        f"{CONDITIONS} out, subject_to: []",
        path=("tune", "subject_to"),
    )


def _intervals(study: Study, point: int, diagram: Diagram) -> dict[str, Sequence[Interval]]:
    """What is sampled of the plant, as intervals that hold the graph's own values too."""
    known = {parameter.label for parameter in diagram.loop.parameters}
    found = dict[str, Sequence[Interval]]()
    for label, (lower, upper) in study.box(point).items():
        if label not in known:
            continue
        block, _, key = label.partition(".")
        own = np.atleast_1d(diagram.models[block].values[key])
        low, high = np.minimum(lower, own).ravel(), np.maximum(upper, own).ravel()
        if not (np.isfinite(low).all() and np.isfinite(high).all()):
            raise ValueFault(f"sample.{label}: {EVERYWHERE} needs ends; clip: [lower, upper] gives them")
        found[label] = [
            Interval(decimal(float(a)), decimal(float(b))) for a, b in zip(low.tolist(), high.tolist(), strict=True)
        ]
    return found


def excess(failing: Sequence[Checked]) -> float:
    """How far from holding: a condition each, and a part for how much the worst one lacks."""
    margins = [item.value for item in failing if item.value is not None and math.isfinite(item.value)]
    lack = max((abs(min(value, 0.0)) for value in margins), default=0.0)
    return len(failing) + lack / (1 + lack) if failing else 0.0


def unstable(study: Study, point: int, period: float) -> float | None:
    """How far the spectral radius of the linearised loop is above 1, on a clock [s] and on shorter ones by halves.

    Down to the graph's own clock. At most zero where it is stable on all of them; None where no set-point was found.
    """
    experiment = study.points[point].graph.experiment
    diagram, numbers = study.loop_of(experiment)
    varied, worst = with_values(diagram, numbers), -math.inf
    own = experiment.file.clock or period
    while True:
        radius = sampled_radius(varied, period, experiment.start)
        if radius is None:
            return None
        worst = max(worst, radius - 1)
        if period <= own:
            return worst - TOLERANCE
        period = max(period / 2, own)


@final
@dataclass(frozen=True)
class Family:
    """The plants over which candidates are judged: each point of the grid with each sample.

    Parameters
    ----------
    study
        The study with its own values.
    """

    study: Study

    @cached_property
    def size(self) -> int:
        """How many."""
        return self.study.runs

    def rows(self, candidate: Study, members: Sequence[int], threads: int) -> dict[str, Any]:
        """The table of some members, by their number as runs have it, in their order."""
        points, parts = len(self.study.points), list[dict[str, Any]]()
        order = list[int]()
        for point in range(points):
            mine = [member for member in members if member % points == point]
            if mine:
                samples = np.array([member // points for member in mine], dtype=np.int64)
                parts.append(candidate.rows_of(point, samples, threads=threads))
                order += mine
        back = [order.index(member) for member in members] if points > 1 else range(len(members))
        names = set(parts[0]).intersection(*parts)
        whole = {name: [item for part in parts for item in part[name]] for name in names}
        return {name: [column[place] for place in back] for name, column in whole.items()}
