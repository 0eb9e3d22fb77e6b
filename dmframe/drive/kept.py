"""Rehearsals that were passed, kept by a digest of all that can alter a command; see `dmframe.drive.identity`."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import platformdirs

from dmframe.drive.identity import Identity, differences, key_of
from dmframe.errors import OutputError
from dmframe.files import write_text, writing
from dmframe.seal import BrokenSeal, opened, sealed
from dmframe.units import plain

if TYPE_CHECKING:
    from dmframe.drive.rehearse import Rehearsal

SHOWN: Final = 3
"""So many changes since a rehearsal are named; of others their number."""


def keep(rehearsal: Rehearsal) -> bool:
    """Note a rehearsal that was passed in full, or forget one that was not passed; True where it is noted.

    One that was cut short, or that left conditions out, is neither.

    Raises
    ------
    OutputError
        The folder where the platform keeps such notes cannot be written.
    """
    if rehearsal.identity is None or (rehearsal.passed and not rehearsal.whole):
        return False
    place = _folder() / f"{key_of(rehearsal.identity)}.json"
    with writing(place):
        if not rehearsal.passed:
            place.unlink(missing_ok=True)
            return False
        place.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        made = {
            **rehearsal.summary,
            "time": datetime.now(UTC).isoformat(timespec="seconds"),
            "until": rehearsal.until,
            "identity": {part: dict(items) for part, items in rehearsal.identity.items()},
        }
        write_text(place, sealed(made))
    return True


def refusal(name: str, now: Identity, until: float) -> str:
    """Why no kept rehearsal is valid for what is about to be driven; empty where one is.

    Parameters
    ----------
    now
        Of what drives.
    until
        How long it is to be driven [s].
    """
    try:
        folder = _folder()
    except OutputError as error:
        return error.text
    place = folder / f"{key_of(now)}.json"
    again = "run dmframe rehearse with the same graph, --set and --limits"
    held = _read(place)
    if held is None:
        expected = f"expected a graph whose rehearsal was passed, found none of exactly this graph; {again}"
        if place.is_file():
            return f"{expected}: {place} is damaged or was edited, and does not count"
        return f"{expected}{_changed(folder, name, now)}"
    if held["identity"] != {part: dict(items) for part, items in now.items()}:
        return f"expected a rehearsal of exactly this graph, found one of another under its name; {again}"
    if until > held["until"]:
        return (
            f"expected a drive of {plain(held['until'], 's')} at most, as the rehearsed graph's, found "
            f"{plain(until, 's')}; rehearse the graph with that duration"
        )
    return ""


def _changed(folder: Path, name: str, now: Identity) -> str:
    """What is another since the rehearsal of this graph that is nearest."""
    nearest: tuple[str, list[str]] | None = None
    for path in folder.glob("*.json"):
        held = _read(path)
        if held is not None and held["graph"] == name:
            found = differences(held["identity"], now)
            if nearest is None or len(found) < len(nearest[1]):
                nearest = held["time"], found
    if nearest is None or not nearest[1]:
        return ""
    time, found = nearest
    more = f"; and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
    return f". Since its rehearsal of {time} this has changed: {'; '.join(found[:SHOWN])}{more}"


def _read(path: Path) -> dict[str, Any] | None:
    """A note that is whole and says that its rehearsal was passed."""
    try:
        held = opened(path.read_bytes())
    except (OSError, BrokenSeal):
        return None
    known = all(key in held for key in ("graph", "time", "until", "identity"))
    return held if known and held.get("passed") is True else None


def _folder() -> Path:
    try:
        folder = Path(platformdirs.user_state_dir("dmframe", appauthor=False))
    except RuntimeError:  # a user without a home
        folder = Path("~")
    if not folder.is_absolute():
        raise OutputError("rehearsals: expected a user with a home, where they are kept, found none")
    return folder / "rehearsals"
