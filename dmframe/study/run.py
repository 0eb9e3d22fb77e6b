"""A study run from a program or a notebook, as `dmframe study` runs it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from dmframe.errors import EngineError
from dmframe.graph.progress import counting
from dmframe.results.folder import safe_name
from dmframe.study.execute import State, run_study
from dmframe.study.results import Results

if TYPE_CHECKING:
    from dmframe.study.plan import Study


def default_folder(study: Study) -> Path:
    """Where a study's results lie if nobody says where."""
    return Path("studies", safe_name(study.name))


def run_whole(
    study: Study,
    out: str | Path | None,
    *,
    workers: int | None,
    scheduler: str | None,
    force: bool,
    progress: bool | None,
) -> Results:
    """See `Study.run`."""
    place = default_folder(study) if out is None else out
    with counting(study.name, study.runs, "runs", quiet=None if progress is None else not progress) as bar:

        def told(state: State) -> None:
            bar(state.kept, f"{len(state.failed)} chunks failed" if state.failed else "")

        state = run_study(study, place, workers=workers, scheduler=scheduler, force=force, told=told)
    if not state.complete:
        why = [state.lost] if state.lost else [f"{chunk}: {text}" for chunk, text in state.failed.items()]
        kept = f"{state.kept} of {state.runs} runs are kept in {place}, the same call continues"
        raise EngineError(f"{study.name}: {why[0]}{f'; and {len(why) - 1} more' if len(why) > 1 else ''}; {kept}")
    return Results(place, study)
