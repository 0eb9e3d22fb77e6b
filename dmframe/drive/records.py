"""Storage of passed rehearsals, by the digest of their identity; see `dmframe.drive.identity`."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import platformdirs

from dmframe.common.errors import OutputError
from dmframe.common.files import write_text, writing
from dmframe.common.seal import BrokenSeal, opened, sealed
from dmframe.common.units import plain
from dmframe.drive.identity import Identity, differences, key_of

if TYPE_CHECKING:
    from dmframe.drive.rehearse import Rehearsal

SHOWN: Final = 3
"""Number of changes since a rehearsal that a message names."""


def store(rehearsal: Rehearsal) -> bool:
    """Store a complete passed rehearsal, or delete the record of a failed one; True if it is stored.

    A shortened rehearsal, or one with other conditions, is neither stored nor deletes a record.

    Raises
    ------
    OutputError
        The state folder of the platform cannot be written.
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
    """Reason for which no stored rehearsal is valid for a drive; empty if one is.

    Parameters
    ----------
    now
        Identity of the drive.
    until
        Duration of the drive [s].
    """
    try:
        folder = _folder()
    except OutputError as error:
        return error.text
    place = folder / f"{key_of(now)}.json"
    remedy = "run dmframe rehearse with the same graph, --set and --limits"
    record = _read(place)
    if record is None:
        expected = f"expected a passed rehearsal of exactly this graph, found none; {remedy}"
        if place.is_file():
            return f"{expected}: {place} is damaged or was edited"
        return f"{expected}{_changed(folder, name, now)}"
    if record["identity"] != {part: dict(items) for part, items in now.items()}:
        return f"expected a rehearsal of exactly this graph, found another one under its name; {remedy}"
    if until > record["until"]:
        return (
            f"expected a drive of at most {plain(record['until'], 's')}, the duration of the rehearsed graph, found "
            f"{plain(until, 's')}; rehearse the graph with that duration"
        )
    return ""


def _changed(folder: Path, name: str, now: Identity) -> str:
    """Changes since the stored rehearsal of this graph with the fewest differences."""
    nearest: tuple[str, list[str]] | None = None
    for path in folder.glob("*.json"):
        record = _read(path)
        if record is not None and record["graph"] == name:
            found = differences(record["identity"], now)
            if nearest is None or len(found) < len(nearest[1]):
                nearest = record["time"], found
    if nearest is None or not nearest[1]:
        return ""
    time, found = nearest
    more = f"; and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
    return f". Changes since its rehearsal of {time}: {'; '.join(found[:SHOWN])}{more}"


def _read(path: Path) -> dict[str, Any] | None:
    """Read the record of a passed rehearsal; None if it is damaged."""
    try:
        record = opened(path.read_bytes())
    except (OSError, BrokenSeal):
        return None
    known = all(key in record for key in ("graph", "time", "until", "identity"))
    return record if known and record.get("passed") is True else None


def _folder() -> Path:
    try:
        folder = Path(platformdirs.user_state_dir("dmframe", appauthor=False))
    except RuntimeError:  # a user without a home
        folder = Path("~")
    if not folder.is_absolute():
        raise OutputError("rehearsals: expected a home folder, in which they are stored, found none")
    return folder / "rehearsals"
