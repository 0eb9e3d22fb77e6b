"""Trials of a search in an Optuna journal, and their Pareto front."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from dmframe.common.errors import MissingError, OutputError
from dmframe.common.files import writing
from dmframe.common.version import installing
from dmframe.study.identity import key_of
from dmframe.study.kernel_lock import journal_lock

if TYPE_CHECKING:
    import optuna

    from dmframe.study.tune import Tuning

JOURNAL: Final = "tune.journal"
NAME: Final = "tune"
"""Name of the search in the journal."""
ORDER, STOPPED, FIGURES, WHY = "hardest", "stopped", "figures", "why"
"""Attributes of a trial: its hardest plants, whether it was stopped early, its objectives, and why it was rejected."""


@contextmanager
def opened(folder: Path, tuning: Tuning, *, create: bool) -> Iterator[optuna.Study]:
    """Open the search of a folder."""
    try:
        import optuna
        from optuna.storages import JournalStorage
        from optuna.storages.journal import JournalFileBackend
    except ImportError:
        raise MissingError(f"tuning needs Optuna: {installing('tune')}") from None
    path = folder / JOURNAL
    if not create and not path.is_file():
        raise MissingError(f"{folder}: expected a search, {JOURNAL}, found none")
    with writing(folder, "folder"):
        folder.mkdir(parents=True, exist_ok=True)
        path.touch()
    before = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            storage = JournalStorage(JournalFileBackend(str(path), lock_obj=journal_lock(path)))
            search = optuna.create_study(
                storage=storage,
                sampler=_sampler(tuning.section.seed),
                study_name=NAME,
                directions=["minimize"] * len(tuning.objectives),
                load_if_exists=True,
            )
            _check_same(search, tuning, folder)
            yield search
    finally:
        optuna.logging.set_verbosity(before)


def _check_same(search: optuna.Study, tuning: Tuning, folder: Path) -> None:
    """Raise `OutputError` for a folder that holds another search."""
    mine = {name: key_of({"": part}) for name, part in tuning.identity.items()}
    there = search.user_attrs.get("identity")
    if there is None:
        search.set_user_attr("identity", mine)
        return
    differ = [name for name in {**there, **mine} if there.get(name) != mine.get(name)]
    if differ:
        raise OutputError(
            f"{folder}: holds another search, which differs in: {', '.join(sorted(differ))}; name another folder, or "
            "restore the study's file"
        )


def _sampler(seed: int) -> optuna.samplers.BaseSampler:
    """TPE with random numbers from the seed and the trial's number, so that a continued search is reproducible."""
    from optuna.samplers import BaseSampler, TPESampler

    class ByNumber(BaseSampler):
        def _of(self, trial: Any, what: str = "") -> TPESampler:
            digest = hashlib.sha256(f"{seed} {trial.number} {what}".encode()).digest()
            return TPESampler(seed=int.from_bytes(digest[:4], "big"))

        def infer_relative_search_space(self, study: Any, trial: Any) -> dict[str, Any]:
            return self._of(trial).infer_relative_search_space(study, trial)

        def sample_relative(self, study: Any, trial: Any, search_space: dict[str, Any]) -> dict[str, Any]:
            return self._of(trial).sample_relative(study, trial, search_space)

        def sample_independent(self, study: Any, trial: Any, param_name: str, param_distribution: Any) -> Any:
            return self._of(trial, param_name).sample_independent(study, trial, param_name, param_distribution)

    return ByNumber()


def ended(search: optuna.Study) -> int:
    """Number of trials with a result; one that was interrupted has none."""
    from optuna.trial import TrialState

    return len(search.get_trials(deepcopy=False, states=(TrialState.COMPLETE, TrialState.PRUNED)))


def feasible(search: optuna.Study) -> list[list[float]]:
    """The objectives of all trials that ran over all plants and met all constraints."""
    from optuna.trial import TrialState

    found = search.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    return [each.values for each in found if not each.user_attrs.get(STOPPED)]


def hardest(search: optuna.Study, size: int) -> list[int]:
    """All plants, first those that were hardest for the best trial so far."""
    from optuna.trial import TrialState

    found = [
        each for each in search.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)) if ORDER in each.user_attrs
    ]
    best = min(found, key=lambda each: (each.values[0], each.number), default=None)
    first = [] if best is None else list(best.user_attrs[ORDER])
    return [*first, *sorted(set(range(size)) - set(first))]


@final
@dataclass(frozen=True)
class Trial:
    """A finished trial.

    Parameters
    ----------
    values
        Values by column.
    figures
        Objectives, in order; lower bounds for a trial that was stopped early.
    state
        ``ran``, ``stopped``, ``broken`` (a constraint, or a run that diverged) or ``refused`` before any run.
    why
        Reason for the rejection.
    """

    number: int
    values: Mapping[str, float]
    figures: tuple[float, ...]
    state: str
    why: str


def dominates(one: Sequence[float], other: Sequence[float]) -> bool:
    """True if no objective of one is worse than that of the other, and some is better."""
    return all(a <= b for a, b in zip(one, other, strict=True)) and any(a < b for a, b in zip(one, other, strict=True))


def front_of(trials: Sequence[Trial]) -> list[Trial]:
    """Pareto front of the trials that ran, the first of equal ones."""
    ran = sorted((each for each in trials if each.state == "ran"), key=lambda each: (each.figures, each.number))
    found = list[Trial]()
    for each in ran:
        if not any(all(a <= b for a, b in zip(other.figures, each.figures, strict=True)) for other in found):
            found.append(each)
    return found
