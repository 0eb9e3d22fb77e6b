"""The journal of a search: trials as Optuna keeps them in a folder, asked by whichever process works on it."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from dmframe.errors import MissingError, OutputError
from dmframe.files import writing
from dmframe.study.identity import key_of
from dmframe.study.kernel_lock import journal_lock

if TYPE_CHECKING:
    import optuna

    from dmframe.study.tune import Tuning

JOURNAL: Final = "tune.journal"
NAME: Final = "tune"
"""Of the search in the journal."""
ORDER, STOPPED, FIGURES, WHY = "hardest", "stopped", "figures", "why"
"""What a trial keeps beside its values: its hardest plants, whether it was stopped early, what it came to, and why."""


@contextmanager
def opened(folder: Path, tuning: Tuning, *, create: bool) -> Iterator[optuna.Study]:
    """The search of a folder."""
    try:
        import optuna
        from optuna.storages import JournalStorage
        from optuna.storages.journal import JournalFileBackend
    except ImportError:
        raise MissingError('tuning needs Optuna: pip install "dmframe[tune]"') from None
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
            held = optuna.create_study(
                storage=storage,
                sampler=_sampler(tuning.section.seed),
                study_name=NAME,
                directions=["minimize"] * len(tuning.objectives),
                load_if_exists=True,
            )
            _check_same(held, tuning, folder)
            yield held
    finally:
        optuna.logging.set_verbosity(before)


def _check_same(held: optuna.Study, tuning: Tuning, folder: Path) -> None:
    """Refuse a folder whose trials were made for another search."""
    mine = {name: key_of({"": part}) for name, part in tuning.identity.items()}
    there = held.user_attrs.get("identity")
    if there is None:
        held.set_user_attr("identity", mine)
        return
    differ = [name for name in {**there, **mine} if there.get(name) != mine.get(name)]
    if differ:
        raise OutputError(
            f"{folder}: holds another search, which differs in: {', '.join(sorted(differ))}; name another folder, or "
            "take the study's file as it was"
        )


def _sampler(seed: int) -> optuna.samplers.BaseSampler:
    """TPE, whose random numbers follow from the seed and the trial's number: a search that goes on is the same."""
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


def ended(held: optuna.Study) -> int:
    """Trials that say something; one that was stopped by Ctrl-C does not."""
    from optuna.trial import TrialState

    return len(held.get_trials(deepcopy=False, states=(TrialState.COMPLETE, TrialState.PRUNED)))


def feasible(held: optuna.Study) -> list[list[float]]:
    """The objectives of all trials that ran to their end and broke nothing."""
    from optuna.trial import TrialState

    found = held.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    return [each.values for each in found if not each.user_attrs.get(STOPPED)]


def hardest(held: optuna.Study, size: int) -> list[int]:
    """All plants; first those that were the hardest for the best trial so far."""
    from optuna.trial import TrialState

    found = [
        each for each in held.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)) if ORDER in each.user_attrs
    ]
    best = min(found, key=lambda each: (each.values[0], each.number), default=None)
    first = [] if best is None else list(best.user_attrs[ORDER])
    return [*first, *sorted(set(range(size)) - set(first))]
