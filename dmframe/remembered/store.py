"""Verdicts on the disk: one file each, written atomically, accessible to this user only.

A file contains a digest and, compressed, a JSON object. It is written to another name and renamed, so that several
processes can write the same entry. An entry that is damaged, or that other users may have written, is ignored.
"""

from __future__ import annotations

import json
import os
import stat
import sys
import zlib
from contextlib import suppress
from typing import Any, Final

from dmframe.remembered.inputs import digest

FORMAT: Final = 1
MOST: Final = 400
"""Largest number of entries; the oldest are removed first."""
FOLDER: Final = "verdicts"
SUFFIX: Final = ".verdict"
_HEAD: Final = 40


def folder() -> str | None:
    """Folder of the entries, in the folder of `dmframe.build.cache.cache_folder`; None without one.

    On Linux it is found without platformdirs, whose import takes as long as all other steps.
    """
    named = os.environ.get("DMFRAME_CACHE")
    if not named and sys.platform.startswith("linux"):
        named = os.environ.get("XDG_CACHE_HOME", "").strip() or "~/.cache"
        named = os.path.join(named, "dmframe")  # noqa: PTH118 - pathlib takes long to import
    if not named:
        from dmframe.build.cache import cache_folder

        with suppress(OSError):
            named = str(cache_folder())
    if not named:
        return None
    place = os.path.expanduser(named)  # noqa: PTH111 - as above
    return None if place.startswith("~") else os.path.join(os.path.abspath(place), FOLDER)  # noqa: PTH100, PTH118


def find(place: str, key: str) -> dict[str, Any] | None:
    """The entry of a key; None without a valid one."""
    path = os.path.join(place, key + SUFFIX)  # noqa: PTH118 - as above
    try:
        if _foreign(os.lstat(place), stat.S_ISDIR) or _foreign(os.lstat(path), stat.S_ISREG):
            return None
        with open(path, "rb") as file:  # noqa: PTH123 - as above
            head, packed = file.read(_HEAD).decode("ascii"), file.read()
        if head != digest(packed):
            return None
        found = json.loads(zlib.decompress(packed))
    except (OSError, ValueError, zlib.error):
        return None
    return found if isinstance(found, dict) and found.get("format") == FORMAT and found.get("key") == key else None


def keep(place: str, key: str, entry: dict[str, Any]) -> bool:
    """Write an entry; returns False if the folder cannot be used."""
    packed = zlib.compress(json.dumps({**entry, "format": FORMAT, "key": key}).encode(), 6)
    path = os.path.join(place, key + SUFFIX)  # noqa: PTH118 - as above
    part = f"{path}.{os.getpid()}.{os.urandom(4).hex()}.part"
    try:
        os.makedirs(place, mode=0o700, exist_ok=True)  # noqa: PTH103 - as above
        if _foreign(os.lstat(place), stat.S_ISDIR):
            return False
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(digest(packed).encode("ascii") + packed)
            os.replace(part, path)  # noqa: PTH105 - as above
        except BaseException:
            with suppress(OSError):
                os.unlink(part)  # noqa: PTH108 - as above
            raise
    except OSError:
        return False
    _evict(place)
    return True


def _foreign(status: os.stat_result, kind: Any) -> bool:
    """True for a file of another kind, or one that other users may have written."""
    own = not hasattr(os, "getuid") or status.st_uid == os.getuid()
    return not (kind(status.st_mode) and own) or bool(status.st_mode & 0o022)


def _evict(place: str) -> None:
    """Remove the oldest entries, and temporary files of killed processes."""
    with suppress(OSError):
        found = list[tuple[float, str]]()
        for item in os.scandir(place):
            with suppress(OSError):
                found.append((item.stat().st_mtime, item.path))
        for _, path in sorted(found, reverse=True)[MOST:]:
            with suppress(OSError):
                os.unlink(path)  # noqa: PTH108 - as above
