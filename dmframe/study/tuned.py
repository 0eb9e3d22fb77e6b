"""What tuning has found: the values, checked on fresh plants and over longer runs, as graphs with their proofs."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from dmframe.analysis.period import TOLERANCE, sampled_radius
from dmframe.config.experiment import Experiment
from dmframe.errors import MissingError
from dmframe.files import write_bytes, write_text, writing
from dmframe.graph import Graph
from dmframe.study.beside import write_graph
from dmframe.study.candidate import Family
from dmframe.study.cautions import CLOSE, LONGER, near_end, notices, with_unit
from dmframe.study.front import Trial, front_of
from dmframe.study.plan import Study
from dmframe.study.tune import Tuning

if TYPE_CHECKING:
    from dmframe.report import Verification

MOST: Final = 3
"""Points of the front that are checked and proved."""
_FRESH: Final = 2**63
"""Between the seed of the search's plants and that of the fresh ones."""
PAGE, PROOF, SUMMARY, FIGURES = "report.html", "certificate.html", "tuned.json", "figures"


@final
@dataclass(frozen=True, repr=False, eq=False)
class Chosen:
    """A set of values that was checked.

    Parameters
    ----------
    label
        ``own``, the graph's, or ``tuned``, ``tuned_1``, ...
    trial
        In which it was tried; None for the graph's own values that the search did not try.
    values
        By column of what was searched.
    searched
        The objectives over the plants of the search; of values that were not tried there, nothing.
    fresh
        The same over plants that the search has not seen; empty where nothing is sampled.
    longer
        The same over those plants and `LONGER` times as long.
    graph
        The study's graph with these values.
    radius
        The larger spectral radius of the loop linearised on the graph's clock; None without a clock or a set-point.
    proof
        Its certificate; None for the graph's own values.
    broken
        Limits that do not hold over the fresh plants, or over longer runs, in words.
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
        """Near its set-point, linearised, on its clock."""
        return self.radius is not None and self.radius > 1 + TOLERANCE

    def told(self, tuning: Tuning, mark: str = "") -> list[str]:
        """Its values with their units; a `mark` stands on both sides of each name."""
        units = {name: factor.unit for name, factor in tuning.columns.items()}
        return [f"{mark}{name}{mark} = {with_unit(value, units[name])}" for name, value in self.values.items()]


@final
@dataclass(frozen=True, repr=False, eq=False)
class Tuned:
    """A search and what it found.

    Parameters
    ----------
    trials
        All that have ended.
    own
        The graph's own values; None where they lie outside of what was searched.
    front
        The best, of which none is better in all objectives than another; in the order of the first objective.
    size
        How many of the front there are; `front` holds at most `MOST` of them, spread over it.
    """

    tuning: Tuning
    folder: Path
    trials: tuple[Trial, ...]
    own: Chosen | None
    front: tuple[Chosen, ...]
    size: int

    @property
    def best(self) -> Chosen:
        """The best by the first objective. Raises `MissingError` where no trial keeps to all limits."""
        if not self.front:
            raise MissingError(f"{self.folder}: {self.counts}; none keeps to all limits")
        return self.front[0]

    @property
    def graph(self) -> Graph:
        """The study's graph with the best values by the first objective."""
        return self.best.graph

    @property
    def counts(self) -> str:
        """How the trials ended, in words."""
        told = {
            "ran": "ran over all plants",
            "stopped": "were stopped early",
            "broken": "broke a limit or diverged",
            "refused": "were refused before any run",
        }
        counts = {state: sum(trial.state == state for trial in self.trials) for state in told}
        parts = [f"{counts[state]} {text}" for state, text in told.items() if counts[state]]
        return f"of {sum(counts.values())} trials " + (", ".join(parts) or "none ended")

    @property
    def misled(self) -> bool:
        """Over longer runs the best values are worse than the graph's own, or diverge."""
        if not self.front or not self.front[0].longer:
            return False
        own, first = self.own, self.front[0].longer[0]
        return not math.isfinite(first) or (own is not None and bool(own.longer) and own.longer[0] < first)

    @property
    def quiet(self) -> bool:
        """The study's loops draw no random numbers."""
        return not self.tuning.study.noisy

    @cached_property
    def notices(self) -> tuple[str, ...]:
        """What a user should know before using the values."""
        return tuple(notices(self))

    @property
    def summary(self) -> dict[str, Any]:
        """All of it as plain data."""
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
        """Write graphs, figures, the proofs' page and the report into the folder, and return the report's path.

        Raises
        ------
        OutputError
            The folder cannot be written.
        """
        from dmframe.plotting import files_of
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
            lines.append(f"  {each.label}: {', '.join(each.told(self.tuning))}")
            lines += [f"    {line}" for line in _figures(self.tuning, each)]
        return "\n".join([*lines, *(f"  {notice}" for notice in self.notices)])


def tuned_of(tuning: Tuning, folder: Path, tell: Callable[[str], None] = lambda _: None) -> Tuned:
    """What the search of a folder has found, checked and proved; see `Tuned`.

    Raises
    ------
    MissingError
        There is no search in the folder.
    """
    trials = tuple(tuning.trials(folder))
    front = front_of(trials)
    shown = _spread(front)
    fresh, longer = _families(tuning)
    labels = ["tuned"] if len(shown) == 1 else [f"tuned_{k}" for k in range(1, len(shown) + 1)]
    found = list[Chosen]()
    for label, trial in zip(labels, shown, strict=True):
        tell(f"checking {label}")
        found.append(_checked(tuning, label, trial.values, trial, fresh, longer, prove=True))
    own, chosen = tuning.own, None
    if own is not None:
        tell("checking the graph's own values")
        tried = next((each for each in trials if each.state == "ran" and dict(each.values) == own), None)
        chosen = _checked(tuning, "own", own, tried, fresh, longer, prove=False)
    return Tuned(tuning, folder, trials, chosen, tuple(found), len(front))


def _spread(front: Sequence[Trial]) -> list[Trial]:
    """At most `MOST` of them, with both ends."""
    if len(front) <= MOST:
        return list(front)
    places = {round(k * (len(front) - 1) / (MOST - 1)) for k in range(MOST)}
    return [front[place] for place in sorted(places)]


def _families(tuning: Tuning) -> tuple[Family | None, Family | None]:
    """Fresh plants, and those to be run for longer; none where nothing is sampled, or where the grid says how long."""
    study = tuning.study
    section, fresh = study.file.sample, study
    if study.factors or study.noisy:
        seed = (section.seed + _FRESH) % 2**64
        sample = section.model_copy(update={"seed": seed, "runs": tuning.section.fresh or section.runs})
        fresh = replace(study, file=study.file.model_copy(update={"sample": sample}))
        fresh.__dict__["_loops"] = study._loops
    times = any(label == "duration" for axis in study.axes for label in axis.labels)
    return (Family(fresh) if fresh is not study else None), (None if times else Family(fresh))


def _checked(
    tuning: Tuning,
    label: str,
    values: Mapping[str, float],
    trial: Trial | None,
    fresh: Family | None,
    longer: Family | None,
    *,
    prove: bool,
) -> Chosen:
    candidate = tuning.candidate(values)
    experiment = candidate.points[0].graph.experiment
    if prove:
        title = f"{experiment.file.title or experiment.name}; {', '.join(tuning.columns)} tuned by {tuning.study.name}"
        experiment = replace(experiment, name=label, file=experiment.file.model_copy(update={"title": title}))
    graph = Graph(experiment)
    told, long, broken = tuple[float, ...](), tuple[float, ...](), list[str]()
    if fresh is not None:
        if tuning.study.noisy:
            candidate = candidate.on({name: _other_noise(base) for name, base in candidate.bases.items()})
        figures, rows = tuning.figures_of(_of(candidate, fresh.study), fresh)
        told = tuple(figures)
        broken += _broken(tuning, rows, "on fresh plants")
    if longer is not None:
        bases = {name: base.with_duration(LONGER * base.file.duration) for name, base in candidate.bases.items()}
        figures, rows = tuning.figures_of(_of(candidate.on(bases), longer.study), longer)
        long = tuple(figures)
        broken += _broken(tuning, rows, f"{LONGER:g} times as long")
    radius = None if graph.clock is None else sampled_radius(graph.diagram, graph.clock, experiment.start)
    proof = graph.verify() if prove else None
    searched = trial.figures if trial is not None else ()
    number = None if trial is None else trial.number
    return Chosen(label, number, dict(values), searched, told, long, graph, radius, proof, tuple(broken))


def _other_noise(base: Experiment) -> Experiment:
    """The graph with other random numbers than those of the search."""
    return base.changed({"seed": (base.file.seed + _FRESH) % 2**64})


def _broken(tuning: Tuning, rows: Mapping[str, Any], where: str) -> list[str]:
    """The limits that some runs do not keep to, with the figure."""
    values = [(each, each.statistic.of(each.statistic.figures(rows))) for each in tuning.bounds]
    beyond = [(each, value) for each, value in values if not each.excess(value) <= 0]  # of nan, too
    return [f"{where} {each.text} does not hold: it is {each.statistic.shown(value)}" for each, value in beyond]


def _of(candidate: Study, family: Study) -> Study:
    """The candidate's graphs with the plants of a family."""
    return family.on(candidate.bases)


def _figures(tuning: Tuning, each: Chosen) -> list[str]:
    parts = {"in the search": each.searched, "on fresh plants": each.fresh, f"{LONGER:g} times as long": each.longer}
    lines = list[str]()
    for what, values in parts.items():
        pairs = zip(tuning.objectives, values, strict=True) if values else ()
        lines += [f"{what}: {', '.join(f'{of.text} {of.shown(value)}' for of, value in pairs)}"] if values else []
    return lines


def _plain(each: Chosen, names: Sequence[str]) -> dict[str, Any]:
    def told(values: Sequence[float]) -> dict[str, float | None]:
        pairs = zip(names, values, strict=True) if values else ()
        return {name: value if math.isfinite(value) else None for name, value in pairs}

    return {
        "label": each.label,
        "trial": each.trial,
        "values": dict(each.values),
        "searched": told(each.searched),
        "fresh": told(each.fresh),
        "longer": told(each.longer),
        "broken": list(each.broken),
        "radius": each.radius,
        "proof": None if each.proof is None else each.proof.headline,
    }


__all__ = ["CLOSE", "LONGER", "Chosen", "Tuned", "near_end", "tuned_of"]
