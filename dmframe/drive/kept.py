"""Rehearsals that were passed, kept by the hash of the graph's text, with everything that is set in it."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import platformdirs

from dmframe.config.experiment import Experiment
from dmframe.errors import OutputError
from dmframe.files import encoded, write_text, writing
from dmframe.results.resolved import resolved_text
from dmframe.version import version


def graph_hash(experiment: Experiment) -> str:
    """SHA-256 of the graph's text with everything said but how long it runs; another gain is another graph."""
    return hashlib.sha256(encoded(resolved_text(experiment.with_duration(1.0)))).hexdigest()


def keep(experiment: Experiment, told: dict[str, Any]) -> None:
    """Note a rehearsal that was passed, or forget one, where it was not.

    Raises
    ------
    OutputError
        The folder where the platform keeps such notes cannot be written.
    """
    place = _place(experiment)
    with writing(place):
        if not told["passed"]:
            place.unlink(missing_ok=True)
            return
        place.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        write_text(place, json.dumps({**told, "version": version()}, indent=1) + "\n")


def passed(experiment: Experiment) -> bool:
    """True where this very graph has passed one, with this version."""
    try:
        held = json.loads(_place(experiment).read_text(encoding="utf-8"))
    except (OSError, ValueError, OutputError):  # none, or a damaged one
        return False
    return isinstance(held, dict) and held.get("passed") is True and held.get("version") == version()


def _place(experiment: Experiment) -> Path:
    try:
        folder = Path(platformdirs.user_state_dir("dmframe", appauthor=False))
    except RuntimeError:  # a user without a home
        folder = Path("~")
    if not folder.is_absolute():
        raise OutputError("rehearsals: expected a user with a home, where they are kept, found none")
    return folder / "rehearsals" / f"{graph_hash(experiment)}.json"
