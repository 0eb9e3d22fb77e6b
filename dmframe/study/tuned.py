"""Result of tuning: values validated on fresh plants and over longer runs, as graphs with their proofs."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from dmframe.analysis.period import TOLERANCE, sampled_radius
from dmframe.common.errors import MissingError
from dmframe.common.files import write_bytes, write_text, writing
from dmframe.graph.graph import Graph
from dmframe.study.cautions import LONGER, notices, with_unit
from dmframe.study.packing import write_graph
from dmframe.study.plan import Study
from dmframe.study.trials import Trial, front_of
from dmframe.study.tune import Tuning

if TYPE_CHECKING:
    from dmframe.report.verification import Verification

MOST: Final = 3
"""Points of the front that are validated and proved."""
_FRESH: Final = 2**63
"""Difference between the seed of the search's plants and that of the new ones."""
PAGE, PROOF, SUMMARY, FIGURES = "report.html", "certificate.html", "tuned.json", "figures"


@final
@dataclass(frozen=True, repr=False, eq=False)
class Chosen:
    """A validated set of values.

    Parameters
    ----------
    label
        ``own``, the graph's values, or ``tuned``, ``tuned_1``, ...
    trial
        Its number in the search; None for the graph's own values if the search did not try them.
    values
        By searched column.
    searched
        The objectives over the plants of the search; empty if the values were not tried there.
    fresh
        The objectives over plants that were not used in the search; empty if nothing is sampled.
    longer
        The objectives over those plants with runs `LONGER` times as long.
    graph
        The study's graph with these values.
    radius
        Spectral radius of the loop linearised and sampled on the graph's clock; None without a clock or a set-point.
    proof
        Its certificate; None for the graph's own values.
    broken
        Constraints violated on the fresh plants or in longer runs, in words.
    """

    label: str
    trial: int | None
    values: Mapping[str, float]
    searched: tuple[float, ...]
    fresh: tuple[float, ...]
    longer: tuple[float, ...]
    graph: Graph
    radius: float | None
    proof: Verification | None = None
    broken: tuple[str, ...] = ()

    @property
    def unstable(self) -> bool:
        """The linearised loop is unstable on its clock."""
        return self.radius is not None and self.radius > 1 + TOLERANCE

    def described(self, tuning: Tuning, mark: str = "") -> list[str]:
        """Its values with their units; each name is enclosed in `mark`."""
        units = {name: factor.unit for name, factor in tuning.columns.items()}
        return [f"{mark}{name}{mark} = {with_unit(value, units[name])}" for name, value in self.values.items()]


@final
@dataclass(frozen=True, repr=False, eq=False)
class Tuned:
    """A search and its result.

    Parameters
    ----------
    trials
        All finished trials.
    own
        The graph's own values; None if they lie outside of the searched bounds.
    front
        At most `MOST` points spread over the Pareto front, in the order of the first objective.
    size
        Number of points of the Pareto front.
    """

    tuning: Tuning
    folder: Path
    trials: tuple[Trial, ...]
    own: Chosen | None
    front: tuple[Chosen, ...]
    size: int

    @property
    def best(self) -> Chosen:
        """The best by the first objective. Raises `MissingError` if no trial meets all constraints."""
        if not self.front:
            raise MissingError(f"{self.folder}: {self.counts}; none meets all constraints")
        return self.front[0]

    @property
    def graph(self) -> Graph:
        """The study's graph with the best values by the first objective."""
        return self.best.graph

    @property
    def counts(self) -> str:
        """Numbers of trials by their result, in words."""
        words = {
            "ran": "ran over all plants",
            "stopped": "were stopped early",
            "broken": "violated a constraint or diverged",
            "refused": "were refused before any run",
        }
        counts = {state: sum(trial.state == state for trial in self.trials) for state in words}
        parts = [f"{counts[state]} {text}" for state, text in words.items() if counts[state]]
        return f"of {sum(counts.values())} trials " + (", ".join(parts) or "none ended")

    @property
    def misled(self) -> bool:
        """True if in longer runs the best values are worse than the graph's own, or diverge."""
        if not self.front or not self.front[0].longer:
            return False
        own, first = self.own, self.front[0].longer[0]
        return not math.isfinite(first) or (own is not None and bool(own.longer) and own.longer[0] < first)

    @property
    def quiet(self) -> bool:
        """True if the study's loops have no noise."""
        return not self.tuning.study.noisy

    @cached_property
    def notices(self) -> tuple[str, ...]:
        """Warnings about the values."""
        return tuple(notices(self))

    @property
    def summary(self) -> dict[str, Any]:
        """Plain data for JSON."""
        names = [each.text for each in self.tuning.objectives]
        return {
            "study": self.tuning.study.name,
            "objectives": {each.text: each.unit for each in self.tuning.objectives},
            "subject_to": list(self.tuning.section.subject_to),
            "trials": len(self.trials),
            "counts": self.counts,
            "front": self.size,
            "found": [_plain(each, names) for each in self._rows],
            "notices": list(self.notices),
        }

    @property
    def _rows(self) -> list[Chosen]:
        return [*([self.own] if self.own is not None else []), *self.front]

    def save(self) -> Path:
        """Write graphs, figures, certificates and the report into the folder, and return the report's path.

        Raises
        ------
        OutputError
            The folder cannot be written.
        """
        from dmframe.common.plotting import files_of
        from dmframe.report.write import write_report
        from dmframe.study.tune_figures import figures_of
        from dmframe.study.tune_page import as_html

        with writing(self.folder, "folder"):
            for old in self.folder.glob("tuned*.yaml"):
                old.unlink()
            (self.folder / FIGURES).mkdir(exist_ok=True)
        for each in self.front:
            write_graph(each.graph, self.folder / f"{each.label}.yaml")
        figures = figures_of(self)
        for name, figure in figures.items():
            for file, content in files_of(figure, name, self.tuning.study.name).items():
                write_bytes(self.folder / FIGURES / file, content)
        proofs = [each.proof for each in self.front if each.proof is not None]
        if proofs:
            write_report(self.folder / PROOF, proofs)
        write_text(self.folder / SUMMARY, json.dumps(self.summary, indent=2) + "\n")
        write_text(self.folder / PAGE, as_html(self, figures))
        return self.folder / PAGE

    def __repr__(self) -> str:
        return f"<Tuned {self.tuning.study.name}: {self.counts}; {self.size} on the front>"

    def __str__(self) -> str:
        lines = [f"{self.tuning.study.name}: {self.counts}"]
        for each in self._rows:
            lines.append(f"  {each.label}: {', '.join(each.described(self.tuning))}")
            lines += [f"    {line}" for line in _figures(self.tuning, each)]
        return "\n".join([*lines, *(f"  {notice}" for notice in self.notices)])


def tuned_of(tuning: Tuning, folder: Path, report: Callable[[str], None] = lambda _: None) -> Tuned:
    """The result of a folder's search, validated and proved; see `Tuned`.

    Raises
    ------
    MissingError
        The folder has no search.
    """
    trials = tuple(tuning.trials(folder))
    front = front_of(trials)
    shown = _spread(front)
    fresh, longer = _plants(tuning)
    labels = ["tuned"] if len(shown) == 1 else [f"tuned_{k}" for k in range(1, len(shown) + 1)]
    found = list[Chosen]()
    for label, trial in zip(labels, shown, strict=True):
        report(f"validating {label}")
        found.append(_checked(tuning, label, trial.values, trial, fresh, longer, prove=True))
    own, chosen = tuning.own, None
    if own is not None:
        report("validating the graph's own values")
        tried = next((each for each in trials if each.state == "ran" and dict(each.values) == own), None)
        chosen = _checked(tuning, "own", own, tried, fresh, longer, prove=False)
    return Tuned(tuning, folder, trials, chosen, tuple(found), len(front))


def _spread(front: Sequence[Trial]) -> list[Trial]:
    """At most `MOST` points, with both ends."""
    if len(front) <= MOST:
        return list(front)
    places = {round(k * (len(front) - 1) / (MOST - 1)) for k in range(MOST)}
    return [front[place] for place in sorted(places)]


def _plants(tuning: Tuning) -> tuple[Study | None, Study | None]:
    """Studies of fresh plants and for longer runs; None if nothing is sampled, or if the grid sets the duration."""
    study = tuning.study
    section, fresh = study.file.sample, study
    if study.factors or study.noisy:
        seed = (section.seed + _FRESH) % 2**64
        sample = section.model_copy(update={"seed": seed, "runs": tuning.section.fresh or section.runs})
        fresh = study.altered(file=study.file.model_copy(update={"sample": sample}))
    times = any(label == "duration" for axis in study.axes for label in axis.labels)
    return (fresh if fresh is not study else None), (None if times else fresh)


def _checked(
    tuning: Tuning,
    label: str,
    values: Mapping[str, float],
    trial: Trial | None,
    fresh: Study | None,
    longer: Study | None,
    *,
    prove: bool,
) -> Chosen:
    candidate = tuning.candidate(values)
    graph = candidate.points[0].graph
    if prove:
        title = f"{graph.file.title or graph.name}; {', '.join(tuning.columns)} tuned by {tuning.study.name}"
        graph = replace(graph, name=label, file=graph.file.model_copy(update={"title": title}))
    bases, broken = candidate.bases, list[str]()
    on_fresh, over_longer = list[float](), list[float]()
    if fresh is not None:
        if tuning.study.noisy:
            bases = {name: _other_noise(base) for name, base in bases.items()}
        on_fresh, rows = tuning.figures_of(fresh.altered(bases=bases))
        broken += _broken(tuning, rows, "on fresh plants")
    if longer is not None:
        bases = {name: base.until(LONGER * base.file.duration) for name, base in bases.items()}
        over_longer, rows = tuning.figures_of(longer.altered(bases=bases))
        broken += _broken(tuning, rows, f"{LONGER:g} times as long")
    radius = None if graph.clock is None else sampled_radius(graph.diagram, graph.clock, graph.start)
    proof = graph.verify() if prove else None
    searched = trial.figures if trial is not None else ()
    number = None if trial is None else trial.number
    return Chosen(
        label,
        number,
        dict(values),
        searched,
        tuple(on_fresh),
        tuple(over_longer),
        graph,
        radius,
        proof,
        tuple(broken),
    )


def _other_noise(base: Graph) -> Graph:
    """The graph with other random numbers than in the search."""
    return base.set({"seed": (base.file.seed + _FRESH) % 2**64})


def _broken(tuning: Tuning, rows: Mapping[str, Any], where: str) -> list[str]:
    """Constraints that are violated, with the value of their statistic."""
    values = [(each, each.statistic.of(each.statistic.figures(rows))) for each in tuning.bounds]
    beyond = [(each, value) for each, value in values if not each.violation(value) <= 0]  # true for nan
    return [f"{where} {each.text} does not hold: it is {each.statistic.shown(value)}" for each, value in beyond]


def _figures(tuning: Tuning, each: Chosen) -> list[str]:
    parts = {"in the search": each.searched, "on fresh plants": each.fresh, f"{LONGER:g} times as long": each.longer}
    lines = list[str]()
    for what, values in parts.items():
        pairs = zip(tuning.objectives, values, strict=True) if values else ()
        lines += [f"{what}: {', '.join(f'{of.text} {of.shown(value)}' for of, value in pairs)}"] if values else []
    return lines


def _plain(each: Chosen, names: Sequence[str]) -> dict[str, Any]:
    def by_name(values: Sequence[float]) -> dict[str, float | None]:
        pairs = zip(names, values, strict=True) if values else ()
        return {name: value if math.isfinite(value) else None for name, value in pairs}

    return {
        "label": each.label,
        "trial": each.trial,
        "values": dict(each.values),
        "searched": by_name(each.searched),
        "fresh": by_name(each.fresh),
        "longer": by_name(each.longer),
        "broken": list(each.broken),
        "radius": each.radius,
        "proof": None if each.proof is None else each.proof.headline,
    }
