"""``dmframe tune``: optimise parameters, validate, prove, report."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from dmframe.cli import STOPPED
from dmframe.cli.streams import tell
from dmframe.graph.progress import progress_line
from dmframe.results.folder import safe_name
from dmframe.study.results import default_folder
from dmframe.study.tune import load_tuning
from dmframe.study.tuned import Tuned, tuned_of

POOR = 1


def tune_study(
    source: str, *, out: Path | None, trials: int | None, overrides: Sequence[str], jobs: int, as_json: bool
) -> int:
    """Start or continue a search; returns the exit status."""
    tuning = load_tuning(Path(source), overrides=overrides, threads=jobs)
    folder = out or default_folder(tuning.study).with_name(f"{safe_name(tuning.study.name)}_tuned")
    wanted = trials or tuning.section.trials
    with progress_line(tuning.study.name, quiet=as_json) as progress:
        try:
            tuning.search(folder, wanted, progress)
            found = tuned_of(tuning, folder, progress)
            progress("writing the report")
            page = found.save()
        except KeyboardInterrupt:
            tell(f"{folder} contains the trials so far; the same command continues", aside=True)
            return STOPPED
    tell(json.dumps(found.summary, indent=2) if as_json else f"{found}\nwrote {page}")
    return POOR if is_poor(found) else 0


def is_poor(found: Tuned) -> bool:
    """True without a result, or if it is not proved or is worse in longer runs."""
    return not found.front or found.misled or found.best.proof is None or not found.best.proof.proved
