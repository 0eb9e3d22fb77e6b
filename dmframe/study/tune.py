"""Tuning: search with Optuna for values of a study's graphs that are best over its sampled plants.

Trials are kept in a journal in the folder: the search can be continued, and several processes may work on it. The
values of a trial depend only on the seed, its number and the trials before it.
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

from dmframe.common.cores import cores
from dmframe.common.errors import DmframeError, MissingError, ValueFault
from dmframe.common.files import expanded
from dmframe.common.units import plain
from dmframe.study.candidate import Proofs, rounded, rows_of_runs, unstable, violation, with_tuned
from dmframe.study.grammar import TuneSection, raise_placed
from dmframe.study.objective import (
    CONDITIONS,
    EFFORT,
    EVERYWHERE,
    PERIOD,
    Bound,
    Statistic,
    at_path,
    bound,
    efforts,
    least_period,
    signals_of,
    statistic,
)
from dmframe.study.plan import Study
from dmframe.study.read import load_study
from dmframe.study.trials import (
    FIGURES,
    ORDER,
    STOPPED,
    WHY,
    Trial,
    dominates,
    ended,
    feasible,
    hardest,
    opened,
)
from dmframe.study.varied import Factor, factors_of

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
        Study that measures all signals of the objectives and constraints.
    factors
        Searched quantities.
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
        """Searched quantities by column."""
        return {name: each for each in self.factors for name in each.columns}

    @cached_property
    def identity(self) -> dict[str, Any]:
        """Everything that identifies a search, except its number of trials."""
        section = self.section.model_dump(mode="json", exclude={"trials", "fresh"})
        return {**self.study.identity, "runs": self.study.samples, "tune": section}

    @property
    def own(self) -> dict[str, float] | None:
        """The graph's own values, if they lie within the searched bounds."""
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

    def search(self, folder: Path, trials: int | None = None, report: Callable[[str], None] = lambda _: None) -> int:
        """Run trials until the folder has this number of them, earlier ones included; returns how many there are.

        Raises
        ------
        OutputError
            The folder holds another search, or cannot be written.
        MissingError
            Optuna is not installed.
        KeyboardInterrupt
            After the running trial was marked as interrupted; the next call continues.
        """
        wanted = trials or self.section.trials
        with opened(folder, self, create=True) as search:
            own = self.own
            if own is not None and not search.trials:
                search.enqueue_trial(own, skip_if_exists=True)
            while (done := ended(search)) < wanted:
                self._try(search)
                report(self._line(search, done + 1, wanted))
            return done

    def trials(self, folder: Path) -> list[Trial]:
        """The finished trials of a folder. Raises `MissingError` if it has no search."""
        with opened(folder, self, create=False) as search:
            return [_trial(each, self) for each in search.get_trials(deepcopy=False) if each.state.is_finished()]

    def figures_of(self, candidate: Study) -> tuple[list[float], dict[str, Any]]:
        """The objectives of a candidate over all its runs, and its table."""
        rows = rows_of_runs(candidate, range(candidate.runs), self.threads)
        return [each.of(each.figures(rows)) for each in self.objectives], rows

    def candidate(self, values: Mapping[str, float]) -> Study:
        """The study with these values. Raises `DmframeError` if they are not allowed."""
        return with_tuned(self.study, self.factors, values)

    def values_of(self, params: Mapping[str, float]) -> dict[str, float]:
        """Values of a trial from those that Optuna suggests."""
        found = dict[str, float]()
        for name, each in self.columns.items():
            assert each.spread is not None  # searched quantities are bounded
            found[name] = rounded(params[name], each.spread.lower, each.spread.upper)
        return found

    def _try(self, search: optuna.Study) -> None:
        """Run one trial and record its result."""
        from optuna.trial import TrialState

        trial = search.ask()
        try:
            params = {
                name: trial.suggest_float(name, each.spread.lower, each.spread.upper, log=each.spread.kind == "log")
                for name, each in self.columns.items()
                if each.spread is not None
            }
            begin = time.perf_counter()
            figures, why, name, beyond = self._judged(self.values_of(params), search, trial)
            trial.set_user_attr("seconds", time.perf_counter() - begin)
            trial.set_user_attr(WHY, why)
            trial.set_constraint(name, beyond)
            if figures is None or beyond > 0:
                search.tell(trial, state=TrialState.PRUNED)
            else:
                search.tell(trial, figures)
        except BaseException:
            search.tell(trial, state=TrialState.FAIL)
            raise

    def _judged(
        self, values: Mapping[str, float], search: optuna.Study, trial: optuna.Trial
    ) -> tuple[list[float] | None, str, str, float]:
        """Objectives, reason of a rejection, violated constraint, and its violation (at most zero without one)."""
        try:
            candidate = self.candidate(values)
        except DmframeError as error:
            return None, error.faults[0].text, "graph", 1.0
        for point in range(len(self.study.points)):
            for condition in self.conditions:
                failing = self.proofs.failing(candidate, point, everywhere=condition == EVERYWHERE)
                if failing:
                    return None, f"refused: {failing[0].name} does not hold", condition, violation(failing)
            if self.period is not None:
                beyond = unstable(candidate, point, self.period)
                if beyond is None:
                    return None, "refused: found no set-point for the linearisation", PERIOD, 1.0
                if beyond > 0:
                    return None, f"refused: unstable at a clock of {plain(self.period, 's')}", PERIOD, min(beyond, 1e6)
        return self._run(candidate, search, trial)

    def _run(
        self, candidate: Study, search: optuna.Study, trial: optuna.Trial
    ) -> tuple[list[float] | None, str, str, float]:
        """Run the hardest plants first, and the others unless the candidate is already dominated or infeasible."""
        size, ran = self.study.runs, list[int]()
        order, best = hardest(search, size), feasible(search)
        fraction = self.section.screen
        first = size if fraction is None or size < 8 else max(1, math.ceil(fraction * size))
        parts = [dict[str, Any]()]
        for chunk in (order[place : place + first] for place in range(0, size, first)):
            parts.append(rows_of_runs(candidate, chunk, self.threads))
            ran += chunk
            rows = {name: [item for part in parts[1:] for item in part[name]] for name in parts[-1]}
            figures = [each.figures(rows) for each in self.objectives]
            least = [each.at_least(known, size) for each, known in zip(self.objectives, figures, strict=True)]
            trial.set_user_attr(STOPPED, len(ran) < size)
            trial.set_user_attr(FIGURES, [value if math.isfinite(value) else None for value in least])
            lost = float(np.mean(~np.isfinite(figures[0])))
            if not all(map(math.isfinite, least)) and max(least) == math.inf:
                return None, f"{round(lost * len(ran))} of {len(ran)} runs diverged", "finite", 1.0 + lost
            for each in self.bounds:
                beyond = each.violation(each.statistic.at_least(each.statistic.figures(rows), size))
                if (len(ran) == size and beyond > 0) or each.broken(each.statistic.figures(rows), size):
                    return None, f"{each.text} does not hold", each.text, beyond
            if len(ran) < size and any(dominates(other, least) for other in best):
                return least, "stopped: an earlier trial dominates it", "graph", 0.0
        worst = np.argsort(-figures[0], kind="stable")
        trial.set_user_attr(ORDER, [ran[place] for place in worst.tolist()[:first]])
        return least, "", "graph", 0.0

    def _line(self, search: optuna.Study, done: int, wanted: int) -> str:
        best = feasible(search)
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
        As in `load_study`.
    threads
        Number of threads; by default all cores.

    Raises
    ------
    DmframeError
        All faults of the file at once, each with its line and column.
    """
    study = load_study(source, **options)
    section = study.file.tune
    if section is None:
        raise MissingError(
            f"{study.name}: expected a section tune with the searched quantities, tune: {{dynamics.Gamma: "
            "{log: [1, 1e4]}, minimise: worst rms_final}"
        )
    base = study.bases[""]
    factors, faults = factors_of("tune", section.variations, base, lambda: study.runner.loop_of(base)[0])
    faults += [
        ValueFault(f"tune.{each.name}: expected two bounds, uniform or log, found normal", path=("tune", each.name))
        for each in factors
        if each.spread is not None and each.spread.kind == "normal"
    ]
    if not section.variations:
        faults.append(MissingError("tune: expected parameters to search, such as dynamics.Gamma: {log: [1, 1e4]}"))
    fixed = {label for each in study.factors for label in each.labels}
    fixed |= {label for axis in study.axes for label in (*axis.labels, *axis.scaled)}
    faults += [
        ValueFault(f"tune.{each.name}: {label} is sampled, too; keep one of them", path=("tune", each.name))
        for each in factors
        for label in each.labels
        if label in fixed
    ]
    raise_placed(faults, study.document)
    study = _measuring(study, section)
    study.check()
    return _bound(study, section, tuple(factors), threads or cores())


def _measuring(study: Study, section: TuneSection) -> Study:
    """Study that measures all signals of the objectives and constraints."""
    texts = (*section.minimise, *section.subject_to)
    needed = [signal for text in texts for signal in signals_of(text)]
    if any(text.partition("<")[0].split()[-1:] == [EFFORT] for text in texts):
        needed += efforts(study.runner.loop_of(study.points[0].graph)[0])
    measure = study.file.measure
    signals = tuple(dict.fromkeys([*measure.signals, *needed]))
    file = study.file.model_copy(update={"measure": measure.model_copy(update={"signals": signals})})
    return study.altered(file=file)


def _bound(study: Study, section: TuneSection, factors: tuple[Factor, ...], threads: int) -> Tuning:
    faults, columns = list[DmframeError](), study.measures
    diagram = study.runner.loop_of(study.points[0].graph)[0]
    objectives, bounds, period, conditions = list[Statistic](), list[Bound](), None, list[str]()
    for text in section.minimise:
        try:
            objectives.append(statistic(text, columns, diagram))
        except DmframeError as error:
            faults.append(at_path(error, ("tune", "minimise")))
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
            faults.append(at_path(error, ("tune", "subject_to")))
    if period is not None and unstable(study, 0, period) is None:
        text = "tune.subject_to: found no set-point for the linearisation of the graph; remove stable period"
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
    """Search, and validate the result on fresh plants; see `dmframe.study.tuned.Tuned`.

    Parameters
    ----------
    source
        A study with a section ``tune``: its file, its text or data.
    out
        The folder of the search, which is continued if it exists.
    trials
        Replaces the file's number.
    tell
        Called with a line of text per trial.
    """
    from dmframe.study.tuned import tuned_of

    tuning, folder = load_tuning(source), expanded(out)
    tuning.search(folder, trials, tell)
    return tuned_of(tuning, folder, tell)


def _own(each: Factor, study: Study) -> list[float] | None:
    """Values of a factor at which the graph is unchanged."""
    if each.how != "value":
        return [1.0 if each.how == "scale" else 0.0] * len(each.columns)
    found = dict[str, np.ndarray]()
    replace(each, how="shift").put(found, np.zeros((1, len(each.columns))), study.bases[""])
    first = np.unique(np.stack([rows[0] for rows in found.values()]), axis=0)
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
