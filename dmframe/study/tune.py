"""Search for values of a study's graphs that are best over its sampled plants, on Optuna, to be asked and told.

Trials stand in a journal in the folder: the search goes on after a stop, and several processes may work on it. What is
tried at a trial follows from the seed, its number and the trials before it alone.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np

from dmframe.errors import DmframeError, MissingError, ValueFault
from dmframe.files import expanded
from dmframe.study.candidate import Family, Proofs, excess, rounded, unstable, with_tuned
from dmframe.study.front import Trial, dominates
from dmframe.study.grammar import TuneSection
from dmframe.study.journal import FIGURES, JOURNAL, ORDER, STOPPED, WHY, ended, feasible, hardest, opened
from dmframe.study.objective import (
    CONDITIONS,
    EFFORT,
    EVERYWHERE,
    PERIOD,
    Bound,
    Statistic,
    bound,
    efforts,
    least_period,
    signals_of,
    statistic,
    told,
)
from dmframe.study.plan import Study, load_study
from dmframe.study.read import raise_placed
from dmframe.study.varied import Factor, factor
from dmframe.units import plain

if TYPE_CHECKING:
    import optuna

    from dmframe.study.tuned import Tuned


@final
@dataclass(frozen=True, repr=False, eq=False)
class Tuning:
    """A study with its section ``tune``, ready to search.

    Parameters
    ----------
    study
        Measures what objectives and limits need.
    factors
        What is searched.
    """

    study: Study
    section: TuneSection
    factors: tuple[Factor, ...]
    objectives: tuple[Statistic, ...]
    bounds: tuple[Bound, ...]
    period: float | None
    conditions: tuple[str, ...]
    threads: int
    proofs: Proofs = field(default_factory=Proofs, repr=False)

    @property
    def columns(self) -> dict[str, Factor]:
        """What is searched, by the name of its column."""
        return {name: each for each in self.factors for name in each.columns}

    @cached_property
    def family(self) -> Family:
        """The plants."""
        return Family(self.study)

    @cached_property
    def identity(self) -> dict[str, Any]:
        """What makes two searches the same; not how many trials there are."""
        section = self.section.model_dump(mode="json", exclude={"trials", "fresh"})
        return {**self.study.identity, "runs": self.study.samples, "tune": section}

    @property
    def own(self) -> dict[str, float] | None:
        """The graph's own values, where they lie within the ends."""
        found = dict[str, float]()
        for each in self.factors:
            values = _own(each, self.study)
            if values is None or each.spread is None:
                return None
            for name, value in zip(each.columns, values, strict=True):
                if not each.spread.lower <= value <= each.spread.upper:
                    return None
                found[name] = value
        return found

    def search(self, folder: Path, trials: int | None = None, tell: Callable[[str], None] = lambda _: None) -> int:
        """Try values until there are so many trials in the folder, those of before counted; returns how many there are.

        Raises
        ------
        OutputError
            The folder holds another search, or cannot be written.
        MissingError
            Optuna is not installed.
        KeyboardInterrupt
            After the trial that ran was marked as stopped; the next call goes on.
        """
        wanted = trials or self.section.trials
        with opened(folder, self, create=True) as held:
            own = self.own
            if own is not None and not held.trials:
                held.enqueue_trial(own, skip_if_exists=True)
            while (done := ended(held)) < wanted:
                self._try(held)
                tell(self._line(held, done + 1, wanted))
            return done

    def trials(self, folder: Path) -> list[Trial]:
        """The trials of a folder that have ended. Raises `MissingError` where there is no search."""
        with opened(folder, self, create=False) as held:
            return [_trial(each, self) for each in held.get_trials(deepcopy=False) if each.state.is_finished()]

    def figures_of(self, candidate: Study, family: Family) -> tuple[list[float], dict[str, Any]]:
        """The objectives of a candidate over a whole family, and its table."""
        rows = family.rows(candidate, range(family.size), self.threads)
        return [each.of(each.figures(rows)) for each in self.objectives], rows

    def candidate(self, values: Mapping[str, float]) -> Study:
        """The study with these values. Raises `DmframeError`."""
        return with_tuned(self.study, self.factors, values)

    def values_of(self, params: Mapping[str, float]) -> dict[str, float]:
        """What is tried where Optuna says so."""
        found = dict[str, float]()
        for name, each in self.columns.items():
            assert each.spread is not None  # what is searched has ends
            found[name] = rounded(params[name], each.spread.lower, each.spread.upper)
        return found

    def _try(self, held: optuna.Study) -> None:
        """One trial, from its values to what is told of it."""
        from optuna.trial import TrialState

        trial = held.ask()
        try:
            params = {
                name: trial.suggest_float(name, each.spread.lower, each.spread.upper, log=each.spread.kind == "log")
                for name, each in self.columns.items()
                if each.spread is not None
            }
            begin = time.perf_counter()
            figures, why, name, beyond = self._judged(self.values_of(params), held, trial)
            trial.set_user_attr("seconds", time.perf_counter() - begin)
            trial.set_user_attr(WHY, why)
            trial.set_constraint(name, beyond)
            if figures is None or beyond > 0:
                held.tell(trial, state=TrialState.PRUNED)
            else:
                held.tell(trial, figures)
        except BaseException:
            held.tell(trial, state=TrialState.FAIL)
            raise

    def _judged(
        self, values: Mapping[str, float], held: optuna.Study, trial: optuna.Trial
    ) -> tuple[list[float] | None, str, str, float]:
        """The objectives, why not, and the constraint that is broken with how far; at most zero where none is."""
        try:
            candidate = self.candidate(values)
        except DmframeError as error:
            return None, error.faults[0].text, "graph", 1.0
        for point in range(len(self.study.points)):
            for asked in self.conditions:
                failing = self.proofs.failing(candidate, point, everywhere=asked == EVERYWHERE)
                if failing:
                    return None, f"refused: {failing[0].name} does not hold", asked, excess(failing)
            if self.period is not None:
                beyond = unstable(candidate, point, self.period)
                if beyond is None:
                    return None, "refused: found no set-point about which it could be linearised", PERIOD, 1.0
                if beyond > 0:
                    return None, f"refused: unstable on a clock of {plain(self.period, 's')}", PERIOD, min(beyond, 1e6)
        return self._run(candidate, held, trial)

    def _run(
        self, candidate: Study, held: optuna.Study, trial: optuna.Trial
    ) -> tuple[list[float] | None, str, str, float]:
        """Run the hardest plants first, and others as long as those leave the candidate a chance."""
        size, ran = self.family.size, list[int]()
        order, best = hardest(held, size), feasible(held)
        share = self.section.screen
        first = size if share is None or size < 8 else max(1, math.ceil(share * size))
        parts = [dict[str, Any]()]
        for chunk in (order[place : place + first] for place in range(0, size, first)):
            parts.append(self.family.rows(candidate, chunk, self.threads))
            ran += chunk
            rows = {name: [item for part in parts[1:] for item in part[name]] for name in parts[-1]}
            figures = [each.figures(rows) for each in self.objectives]
            least = [each.at_least(told_, size) for each, told_ in zip(self.objectives, figures, strict=True)]
            trial.set_user_attr(STOPPED, len(ran) < size)
            trial.set_user_attr(FIGURES, [value if math.isfinite(value) else None for value in least])
            lost = float(np.mean(~np.isfinite(figures[0])))
            if not all(map(math.isfinite, least)) and max(least) == math.inf:
                return None, f"{round(lost * len(ran))} of {len(ran)} runs diverged", "finite", 1.0 + lost
            for each in self.bounds:
                beyond = each.excess(each.statistic.at_least(each.statistic.figures(rows), size))
                if (len(ran) == size and beyond > 0) or each.broken(each.statistic.figures(rows), size):
                    return None, f"{each.text} does not hold", each.text, beyond
            if len(ran) < size and any(dominates(other, least) for other in best):
                return least, "stopped: what it showed is worse than one that was found", "graph", 0.0
        worst = np.argsort(-figures[0], kind="stable")
        trial.set_user_attr(ORDER, [ran[place] for place in worst.tolist()[:first]])
        return least, "", "graph", 0.0

    def _line(self, held: optuna.Study, done: int, wanted: int) -> str:
        best = feasible(held)
        found = min(best, default=None)
        shown = (
            "none feasible yet" if found is None else f"{self.objectives[0].text} {self.objectives[0].shown(found[0])}"
        )
        return f"trial {done} of {wanted}: {shown}"


def load_tuning(source: str | Path | Mapping[str, Any] | Study, *, threads: int = 0, **options: Any) -> Tuning:
    """A study with a section ``tune``, checked.

    Parameters
    ----------
    source, options
        As of `load_study`.
    threads
        That run plants at the same time; by default all cores.

    Raises
    ------
    DmframeError
        All faults of the file at once, each with its line and column.
    """
    import os

    study = load_study(source, **options)
    section = study.file.tune
    if section is None:
        raise MissingError(
            f"{study.name}: expected a section tune, which says what is searched: tune: {{dynamics.Gamma: "
            "{log: [1, 1e4]}, minimise: worst rms_final}"
        )
    faults, factors, base = list[DmframeError](), list[Factor](), study.bases[""]
    for name, variation in section.variations.items():
        try:
            found = factor(name, variation, base, lambda: study.loop_of(base)[0])
            if found.spread is not None and found.spread.kind == "normal":
                raise ValueFault("expected two ends, uniform or log; a search has no normal distribution")
            factors.append(found)
        except DmframeError as error:
            for fault in error.faults:
                fault.path = fault.path if fault.location else ("tune", name, *fault.path)
                fault.text = f"tune.{name}: {fault.text.removeprefix(f'{name}: ')}"
                faults.append(fault)
    if not section.variations:
        faults.append(MissingError("tune: expected parameters to search, such as dynamics.Gamma: {log: [1, 1e4]}"))
    fixed = {label for each in study.factors for label in each.labels}
    fixed |= {label for axis in study.axes for label in (*axis.labels, *axis.scaled)}
    faults += [
        ValueFault(f"tune.{each.name}: {label} varies over the plants, too; keep one of them", path=("tune", each.name))
        for each in factors
        for label in each.labels
        if label in fixed
    ]
    raise_placed(faults, study.document)
    study = _measuring(study, section)
    study.check()
    return _bound(study, section, tuple(factors), threads or os.cpu_count() or 1)


def _measuring(study: Study, section: TuneSection) -> Study:
    """The study with the signals measured that objectives and limits need."""
    texts = (*section.minimise, *section.subject_to)
    needed = [signal for text in texts for signal in signals_of(text)]
    if any(text.partition("<")[0].split()[-1:] == [EFFORT] for text in texts):
        needed += efforts(study.loop_of(study.points[0].graph.experiment)[0])
    measure = study.file.measure
    signals = tuple(dict.fromkeys([*measure.signals, *needed]))
    file = study.file.model_copy(update={"measure": measure.model_copy(update={"signals": signals})})
    other = replace(study, file=file)
    other.__dict__["_loops"] = study._loops
    return other


def _bound(study: Study, section: TuneSection, factors: tuple[Factor, ...], threads: int) -> Tuning:
    faults, columns = list[DmframeError](), study.measures
    diagram = study.loop_of(study.points[0].graph.experiment)[0]
    objectives, bounds, period, conditions = list[Statistic](), list[Bound](), None, list[str]()
    for text in section.minimise:
        try:
            objectives.append(statistic(text, columns, diagram))
        except DmframeError as error:
            faults.append(told(error, ("tune", "minimise")))
    if not section.minimise:
        faults.append(MissingError("tune.minimise: expected an objective, found none", path=("tune", "minimise")))
    for text in section.subject_to:
        try:
            if text in (CONDITIONS, EVERYWHERE):
                conditions.append(text)
            elif (found := least_period(text)) is not None:
                period = max(found, period or 0.0)
            else:
                bounds.append(bound(text, columns, diagram))
        except DmframeError as error:
            faults.append(told(error, ("tune", "subject_to")))
    if period is not None and unstable(study, 0, period) is None:
        text = "tune.subject_to: found no set-point about which the graph could be linearised; leave stable period out"
        faults.append(ValueFault(text, path=("tune", "subject_to")))
    raise_placed(faults, study.document)
    return Tuning(study, section, factors, tuple(objectives), tuple(bounds), period, tuple(conditions), threads)


def tune(
    source: str | Path | Mapping[str, Any] | Study,
    out: str | Path,
    *,
    trials: int | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Tuned:
    """Search, and check what was found on fresh plants; see `dmframe.study.tuned.Tuned`.

    Parameters
    ----------
    source
        A study with a section ``tune``: its file, its text or data.
    out
        The folder of the search, which goes on where it is there already.
    trials
        Instead of the file's.
    tell
        Called with a line a trial.
    """
    from dmframe.study.tuned import tuned_of

    tuning, folder = load_tuning(source), expanded(out)
    tuning.search(folder, trials, tell)
    return tuned_of(tuning, folder, tell)


def _own(each: Factor, study: Study) -> list[float] | None:
    """The values of a factor that leave the graph as it is."""
    if each.how != "value":
        return [1.0 if each.how == "scale" else 0.0] * len(each.columns)
    held = dict[str, np.ndarray]()
    replace(each, how="shift").put(held, np.zeros((1, len(each.columns))), study.bases[""])
    first = np.unique(np.stack([rows[0] for rows in held.values()]), axis=0)
    if len(first) > 1:
        return None
    values = np.atleast_1d(first[0])
    if each.elements is None:
        return [float(values[0])] if np.ptp(values) == 0 else None
    return [float(value) for value in np.broadcast_to(values, (each.elements,))]


def _trial(each: Any, tuning: Tuning) -> Trial:
    from optuna.trial import TrialState

    why, figures = each.user_attrs.get(WHY, ""), each.user_attrs.get(FIGURES)
    stopped = bool(each.user_attrs.get(STOPPED))
    state = "broken" if figures is not None else "refused"
    if each.state == TrialState.COMPLETE:
        state = "stopped" if stopped else "ran"
    if each.state == TrialState.FAIL:
        state, why = "interrupted", "interrupted"
    values = tuning.values_of(each.params) if set(each.params) == set(tuning.columns) else {}
    shown = tuple(math.inf if value is None else float(value) for value in figures or ())
    return Trial(each.number, values, shown, state, why)


__all__ = ["JOURNAL", "Trial", "Tuning", "load_tuning", "tune"]
