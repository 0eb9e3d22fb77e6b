"""Whose code a graph runs: ``type: my_file.py:MyBlock`` runs that file, with all the rights of the user.

A file that the user wrote is run. One that others may have written, since it belongs to another user, since all may
write to it or to its folder, or since a browser marked it as downloaded, is run only in a folder that the user has
trusted once.
"""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import Final

import platformdirs

from dmframe.errors import BlockError
from dmframe.files import write_text

_MARKS: Final = ("user.xdg.origin.url", "com.apple.quarantine")
"""What browsers leave on what they have fetched."""


def check(path: Path, where: str) -> None:
    """Raise `BlockError` for a file whose code is not to be run; `where` says who names it."""
    why = _foreign(path)
    if why and not _trusted(path):
        raise BlockError(
            f"{where}: {path.name} would run as your own program, and {why}; read it, then trust its folder once: "
            "add --trust"
        )


def remember(folder: Path) -> None:
    """Trust a folder, and all below it, from now on."""
    known = _known()
    entry = str(folder.resolve())
    if entry not in known:
        place = _place()
        place.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        write_text(place, "".join(f"{line}\n" for line in (*known, entry)))


def _trusted(path: Path) -> bool:
    return any(path.resolve().is_relative_to(folder) for folder in _known())


def _known() -> list[str]:
    try:
        return _place().read_text(encoding="utf-8").splitlines()
    except (OSError, RuntimeError):  # none yet, or a user without a home
        return []


def _place() -> Path:
    return Path(platformdirs.user_config_dir("dmframe", appauthor=False), "trusted_folders")


def _foreign(path: Path) -> str:
    """Why others may have written a file; empty where nothing says so."""
    for place in (path, path.parent):
        told = place.stat()
        if hasattr(os, "getuid") and told.st_uid not in (os.getuid(), 0):
            return f"{place} belongs to another user"
        if told.st_mode & stat.S_IWOTH and not (place != path and told.st_mode & stat.S_ISVTX):
            return f"all users may write to {place}"
    for mark in _MARKS if hasattr(os, "getxattr") else ():
        with suppress(OSError):
            if os.getxattr(path, mark):
                return "it was downloaded"
    return ""
