"""Whose code a graph runs: ``type: my_file.py:MyBlock`` runs that file, with all the rights of the user.

A file that the user wrote is run. One that others may have written, since it or a folder above it belongs to another
user or may be written by others, or since a browser marked it as downloaded, is run only in a folder that the user has
trusted once. It must lie in the graph's folder or below, wherever links lead.
"""

from __future__ import annotations

import json
import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import Final

import platformdirs

from dmframe.errors import BlockError, MissingError
from dmframe.files import reason, write_text

_MARKS: Final = ("user.xdg.origin.url", "com.apple.quarantine")
"""What browsers leave on what they have fetched."""

MOST: Final = 1_000_000
"""Bytes of a file that is not to be run, of which more are not looked at."""


def read(base: Path, file: str, where: str) -> bytes:
    """The content of a block's file that is to be run, named beside the graph in the folder `base`.

    `where` says who names it.

    Raises
    ------
    BlockError, MissingError
        What `look` raises; or it is not to be run.
    """
    content, why = look(base, file, where)
    if why:
        raise BlockError(f"{where}: {why}")
    return content


def look(base: Path, file: str, where: str) -> tuple[bytes, str]:
    """The content of a block's file, and why it is not to be run; empty where it may be.

    What is looked at is what is read: one descriptor, in folders that nobody else can exchange.

    Raises
    ------
    BlockError, MissingError
        It lies outside, it is no file, or there is none.
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
            f"{where}: the file {base / file} does not exist; it is looked for beside the graph"
        ) from None
    except OSError as error:
        raise BlockError(f"{where}: {base / file} cannot be read: {reason(error)}") from None
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise BlockError(f"{where}: expected a file, found {base / file}, which is none")
    with os.fdopen(descriptor, "rb") as opened:
        why = _foreign(path, os.fstat(descriptor))
        if not why or _trusted(path):
            return opened.read(), ""
        return opened.read(MOST), (
            f"{path.name} would run as your own program, and {why}; read it, then trust its folder once: add --trust"
        )


def remember(folder: Path) -> None:
    """Trust a folder, and all below it, from now on. Raises `BlockError` for one that all users share, such as /tmp."""
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
        held = json.loads(_place().read_text(encoding="utf-8"))
    except (OSError, ValueError, RuntimeError):  # none yet, a damaged one, or a user without a home
        return []
    return [entry for entry in held if isinstance(entry, str)] if isinstance(held, list) else []


def _place() -> Path:
    return Path(platformdirs.user_config_dir("dmframe", appauthor=False), "trusted_folders.json")


def _foreign(path: Path, told: os.stat_result) -> str:
    """Why others may have written a file, whose status is `told`; empty where nothing says so."""
    places = [(path, told), *((folder, folder.stat()) for folder in path.parents)]
    for place, status in places:
        if hasattr(os, "getuid") and status.st_uid not in (os.getuid(), 0):
            return f"{place} belongs to another user"
        shared = bool(status.st_mode & stat.S_ISVTX) and place != path  # others may add files there, not exchange ours
        if status.st_mode & stat.S_IWOTH and not shared:
            return f"all users may write to {place}"
        if status.st_mode & stat.S_IWGRP and hasattr(os, "getgid") and status.st_gid not in (os.getgid(), 0):
            return f"a group of users may write to {place}"
    for mark in _MARKS if hasattr(os, "getxattr") else ():
        with suppress(OSError):
            if os.getxattr(path, mark):
                return "it was downloaded"
    return ""
