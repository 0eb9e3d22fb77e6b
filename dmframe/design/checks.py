"""Checks of a tuned law: proof of an adaptive one, and a rehearsal."""

from __future__ import annotations

import json
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

from dmframe.common.errors import DmframeError
from dmframe.common.files import write_text, writing
from dmframe.common.units import plain
from dmframe.design.decide import Candidate
from dmframe.design.designed import LIMITS, Check, Designed
from dmframe.design.progress import Progress
from dmframe.graph.graph import Graph

REHEARSALS: Final = "rehearsals"
LIMIT: Final = 0.1
"""Largest error of a simple law in a rehearsal, that above which a run of the race counts as diverged [rad, m]."""
REHEARSED: Final = 40.0
"""Duration of the rehearsal's runs [s]."""


def checks_of(graph: Graph, candidate: Candidate, found: Designed, progress: Progress) -> Iterator[Check]:
    """Proof of an adaptive law, and rehearsal; the second only if the first passed."""
    if candidate.adaptive:
        progress.say("proof", f"proving {candidate.law}")
        verification = graph.verify()
        if not verification.proved:
            why = f"it is not proved: {verification.headline}, {verification.reason}"
            yield Check("proof", why, passed=False, whole=verification.stable)
            return
        yield Check("proof", verification.headline, passed=True, whole=verification.stable)
    yield rehearsed(graph, candidate, found, progress)


def rehearsed(graph: Graph, candidate: Candidate, found: Designed, progress: Progress) -> Check:
    """A rehearsal, which is kept in the folder.

    A simple law passes if it is not stopped and its error is at most `LIMIT`.
    """
    limits = found.folder / LIMITS
    text = limits.read_text(encoding="utf-8") if limits.exists() else ""
    key = sha256(f"{graph.text}{found.payload}{text}".encode()).hexdigest()
    file = found.folder / REHEARSALS / f"{candidate.law}_{key[:8]}.json"
    kept = _kept(file, key)
    if kept is not None:
        progress.keep("rehearsal")
    else:
        progress.say("rehearsal", f"rehearsing {candidate.law}")
        try:
            kept = graph.rehearse(REHEARSED, payload=found.payload, limits=limits if text else None).summary
        except DmframeError as error:
            return Check("rehearsal", f"it cannot be rehearsed: {error.text}", passed=False)
        with writing(file.parent, "folder"):
            file.parent.mkdir(exist_ok=True)
        write_text(file, json.dumps({**kept, "key": key}, indent=1) + "\n")
    if candidate.adaptive or kept["passed"]:
        passed = bool(kept["passed"])
        return Check("rehearsal", f"passed under all conditions{_ideal(kept)}" if passed else _failure(kept), passed)
    lost = [row for row in kept["conditions"] if row["needed"] and (row["rms"] is None or not row["rms"] <= LIMIT)]
    if lost:
        how = "is stopped" if lost[0]["rms"] is None else f"has an error of {plain(lost[0]['rms'], kept['unit'])}"
        return Check("rehearsal", f"{candidate.law} {how} with {lost[0]['condition']}", passed=False)
    text = (
        f"{candidate.law} is not stopped, and its error is at most {plain(LIMIT, kept['unit'])}, under all conditions"
    )
    return Check("rehearsal", f"{text}{_ideal(kept)}; as a controller for a drive {_failure(kept)}", passed=True)


def _ideal(kept: dict[str, Any]) -> str:
    """Error on the robot of the graph."""
    rms = next((row["rms"] for row in kept["conditions"]), None)
    return "" if rms is None else f"; on the ideal robot its error is {plain(rms, kept['unit'])}"


def _failure(kept: dict[str, Any]) -> str:
    """The first condition of a rehearsal that was not passed."""
    row = next(row for row in kept["conditions"] if row["needed"] and row["why"])
    error = "" if row["rms"] is None else f"its error is {plain(row['rms'], kept['unit'])}, "
    return f"it fails the rehearsal with {row['condition']}: {error}{row['why']}"


def _kept(file: Path, key: str) -> dict[str, Any] | None:
    try:
        found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and found.get("key") == key else None
