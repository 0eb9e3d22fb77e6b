"""Content-addressed cache of compiled libraries.

An entry is one file, ``<key>-<digest>.so``: the key is a hash of the inputs (source, flags, compiler, processor), the
digest of the content. It is built in a temporary folder inside the cache and renamed when it is complete. A killed
process therefore leaves no broken entry, and several processes may build the same entry. An entry whose content does
not match its name, or that belongs to another user, is deleted and built again.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import platformdirs

from dmframe.build.compiler import FLAGS, LONG, SHARED, CompileFailed, Compiler, processor
from dmframe.common.errors import ValueFault
from dmframe.common.files import encoded

VARIABLE: Final = "DMFRAME_CACHE"
MOST_BYTES: Final = 512 * 2**20
"""Size limit of the cache; the least recently used entries are deleted first."""

STALE: Final = 3600.0
"""Age from which a temporary folder is considered left by a killed process [s]."""

_PART: Final = ".part-"

Works = Callable[[Path], bool]
"""Test of a library; see `dmframe.build.trial`."""


def cache_folder() -> Path:
    """Cache folder: ``$DMFRAME_CACHE``, else ``dmframe`` in the platform's cache folder.

    Raises
    ------
    ValueFault
        The variable refers to the home of an unknown user.
    OSError
        The variable is not set, and this user has no home.
    """
    named = os.environ.get(VARIABLE)
    if not named:
        try:
            usual = Path(platformdirs.user_cache_dir("dmframe", appauthor=False))
        except RuntimeError:
            usual = Path()
        if not usual.is_absolute():  # some versions do not expand ~
            raise OSError("this user has no home")
        return usual
    try:
        return Path(named).expanduser().absolute()
    except RuntimeError:
        text = "expected a folder, found the home of an unknown user"
        raise ValueFault(text, location=f"{VARIABLE}={named}") from None


def key_of(source: str, compiler: Compiler) -> str:
    """Hash of everything that determines the machine code."""
    inputs = "\0".join((source, repr((SHARED, FLAGS, LONG)), compiler.identity, processor()))
    return hashlib.sha256(encoded(inputs)).hexdigest()[:40]


def find(folder: Path, key: str) -> Path | None:
    """Entry of a key; damaged entries, and those of other users, are deleted."""
    for path in sorted(folder.glob(f"{key}-*.so")):
        with contextlib.suppress(OSError):
            if _ours(path) and path.name == _name(key, path.read_bytes()):
                os.utime(path)
                return path
        with contextlib.suppress(OSError):
            path.unlink()
    return None


def make(
    folder: Path, key: str, source: str, compiler: Compiler, works: Works = lambda _: True, most: int = MOST_BYTES
) -> Path:
    """Compile an entry into the cache, after `works` has tested the library.

    Raises
    ------
    OSError
        The folder cannot be written.
    CompileFailed
        The compiler failed, the disk is full, or the library does not work.
    """
    prepare(folder)
    with _working(folder) as place:
        library = built(place, source, compiler, works)
        entry = folder / _name(key, library.read_bytes())
        library.chmod(0o700)
        library.replace(entry)
    _evict(folder, entry, most)
    return entry


def built(place: Path, source: str, compiler: Compiler, works: Works) -> Path:
    """Compile in a private folder. Raises `CompileFailed`, also for a library that does not work."""
    text, library = place / "loop.c", place / "loop.so"
    text.write_text(source, encoding="utf-8")
    compiler.build(text, library)
    if not works(library):
        raise CompileFailed(f"{compiler.command[0]} built a library that does not work")
    return library


def prepare(folder: Path) -> None:
    """Create the cache's folder, and refuse one in which others may write, since they could replace entries.

    Raises
    ------
    OSError
        It cannot be created, or others may write to it.
    """
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    if _foreign(folder.stat()):
        raise OSError("others may write there")


def _name(key: str, content: bytes) -> str:
    return f"{key}-{hashlib.sha256(content).hexdigest()[:40]}.so"


def _ours(path: Path) -> bool:
    """True for a file that only this user or root may have written, since it runs with the user's rights."""
    return path.is_file() and not path.is_symlink() and not _foreign(path.lstat())


def _foreign(status: os.stat_result) -> bool:
    """True if other users may have written the file."""
    return hasattr(os, "getuid") and bool(status.st_uid not in (os.getuid(), 0) or status.st_mode & 0o022)


@contextmanager
def _working(folder: Path) -> Iterator[Path]:
    place = Path(tempfile.mkdtemp(prefix=_PART, dir=folder))
    try:
        yield place
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _evict(folder: Path, kept: Path, most: int) -> None:
    """Keep the cache within its size, and delete folders of killed processes."""
    now, entries = time.time(), list[tuple[float, int, Path]]()
    with contextlib.suppress(OSError):
        for path in folder.iterdir():
            with contextlib.suppress(OSError):  # another process may be deleting, too
                status = path.stat()
                if path.name.startswith(_PART) and now - status.st_mtime > STALE:
                    shutil.rmtree(path, ignore_errors=True)
                elif path.suffix == ".so" and path != kept:
                    entries.append((status.st_mtime, status.st_size, path))
        room = most - kept.stat().st_size
        for _, size, path in sorted(entries, reverse=True):
            room -= size
            if room < 0:
                with contextlib.suppress(OSError):
                    path.unlink()
