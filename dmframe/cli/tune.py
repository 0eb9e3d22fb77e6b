"""``dmframe tune``: search, check, prove, write."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from dmframe.cli import STOPPED
from dmframe.cli.streams import tell
from dmframe.graph.progress import telling
from dmframe.results.folder import safe_name
from dmframe.study.run import default_folder
from dmframe.study.tune import load_tuning
from dmframe.study.tuned import Tuned, tuned_of

POOR = 1


def tune_study(
    source: str, *, out: Path | None, trials: int | None, overrides: Sequence[str], jobs: int, as_json: bool
) -> int:
    """Search, or go on with the search of the folder; returns the exit status."""
    tuning = load_tuning(Path(source), overrides=overrides, threads=jobs)
    folder = out or default_folder(tuning.study).with_name(f"{safe_name(tuning.study.name)}_tuned")
    wanted = trials or tuning.section.trials
    with telling(tuning.study.name, quiet=as_json) as progress:
        try:
            tuning.search(folder, wanted, progress)
            found = tuned_of(tuning, folder, progress)
            progress("writing the report")
            page = found.save()
        except KeyboardInterrupt:
            tell(f"{folder} holds what was tried; the same command continues", aside=True)
            return STOPPED
    tell(json.dumps(found.summary, indent=2) if as_json else f"{found}\nwrote {page}")
    return POOR if is_poor(found) else 0


def is_poor(found: Tuned) -> bool:
    """True where nothing was found, or what was found is not proved, or worse over longer runs."""
    return not found.front or found.misled or found.best.proof is None or not found.best.proof.proved
