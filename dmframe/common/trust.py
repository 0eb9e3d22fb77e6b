"""Trust in block files: ``type: my_file.py:MyBlock`` executes that file with the rights of the user.

A file that the user wrote is executed. A file that others may have written is executed only in a folder that the user
has trusted: one that belongs to another user, that others may write to (or a folder above it), or that a browser marked
as downloaded. The file must be in the graph's folder or below, after resolving links.
"""

from __future__ import annotations

import json
import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import Final

import platformdirs

from dmframe.common.errors import BlockError, MissingError
from dmframe.common.files import reason, write_text

_MARKS: Final = ("user.xdg.origin.url", "com.apple.quarantine")
"""Attributes with which browsers mark downloads."""


def read(base: Path, file: str, where: str) -> bytes:
    """Content of a block file, given relative to the graph's folder `base`; `where` is for messages.

    One descriptor is checked and read, in folders that no other user can replace.

    Raises
    ------
    BlockError, MissingError
        The file is outside the folder, is not a regular file, does not exist, or is not trusted.
    """
    try:
        path, folder = (base / file).resolve(), base.resolve()
    except (OSError, RuntimeError, ValueError) as error:  # links in a circle, a name with a null byte
        raise BlockError(f"{where}: {base / file} cannot be found: {error}") from None
    if Path(file).is_absolute() or ".." in Path(file).parts or not path.is_relative_to(folder):
        raise BlockError(f"{where}: expected a file in the graph's folder or below it, found {file}")
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
    except FileNotFoundError:
        raise MissingError(
            f"{where}: the file {base / file} does not exist; its path is relative to the graph's folder"
        ) from None
    except OSError as error:
        raise BlockError(f"{where}: {base / file} cannot be read: {reason(error)}") from None
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise BlockError(f"{where}: expected a regular file, found {base / file}")
    with os.fdopen(descriptor, "rb") as opened:
        why = _foreign(path, os.fstat(descriptor))
        if not why or _trusted(path):
            return opened.read()
    raise BlockError(
        f"{where}: {path.name} would run as your own program, and {why}; read it, then trust its folder once: add "
        "--trust"
    )


def remember(folder: Path) -> None:
    """Trust a folder and all below it from now on. Raises `BlockError` for one that all users share, such as /tmp."""
    place, entry = _place(), str(folder.resolve())
    if folder.is_dir() and folder.stat().st_mode & stat.S_ISVTX and folder.stat().st_mode & stat.S_IWOTH:
        raise BlockError(f"--trust: all users share {folder}; move the graph to a folder of its own")
    known = _known()
    if entry not in known:
        place.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        write_text(place, json.dumps([*known, entry], indent=1) + "\n")


def _trusted(path: Path) -> bool:
    return any(path.is_relative_to(folder) for folder in _known())


def _known() -> list[str]:
    try:
        data = json.loads(_place().read_text(encoding="utf-8"))
    except (OSError, ValueError, RuntimeError):  # none yet, a damaged one, or a user without a home
        return []
    return [entry for entry in data if isinstance(entry, str)] if isinstance(data, list) else []


def _place() -> Path:
    return Path(platformdirs.user_config_dir("dmframe", appauthor=False), "trusted_folders.json")


def _foreign(path: Path, own: os.stat_result) -> str:
    """Why others may have written a file with the status `own`; empty if they cannot."""
    places = [(path, own), *((folder, folder.stat()) for folder in path.parents)]
    for place, status in places:
        if hasattr(os, "getuid") and status.st_uid not in (os.getuid(), 0):
            return f"{place} belongs to another user"
        shared = bool(status.st_mode & stat.S_ISVTX) and place != path  # others may add files, but not replace ours
        if status.st_mode & stat.S_IWOTH and not shared:
            return f"all users may write to {place}"
        if status.st_mode & stat.S_IWGRP and hasattr(os, "getgid") and status.st_gid not in (os.getgid(), 0):
            return f"a group of users may write to {place}"
    for mark in _MARKS if hasattr(os, "getxattr") else ():
        with suppress(OSError):
            if os.getxattr(path, mark):
                return "it was downloaded"
    return ""
