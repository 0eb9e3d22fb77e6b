"""Compiled libraries, kept by the content of what they were compiled from.

An entry is one file, ``<key>-<digest>.so``: the key says from what it was made (source, flags, compiler, processor),
the digest what it holds. It is made in a folder of its own beside its place, and renamed when it is whole; so nothing
that happens to a process at any moment can leave a broken entry, and several may make the same at once. One whose
content is not what its name says, or which belongs to somebody else, is thrown away and made again.
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

from dmframe.build.compiler import FLAGS, SHARED, CompileFailed, Compiler, processor
from dmframe.errors import ValueFault
from dmframe.files import encoded

VARIABLE: Final = "DMFRAME_CACHE"
MOST_BYTES: Final = 512 * 2**20
"""What entries may take together; the least recently used go first."""

STALE: Final = 3600.0
"""A folder in which nobody has worked for so long was left by a process that was killed [s]."""

_PART: Final = ".part-"

Works = Callable[[Path], bool]
"""True for a library that does what it should; see `dmframe.build.trial`."""


def cache_folder() -> Path:
    """``$DMFRAME_CACHE``, else ``dmframe`` in the folder where the platform keeps caches.

    Raises
    ------
    ValueFault
        The variable names the home of a user whom nobody knows.
    OSError
        It names none, and this user has no home.
    """
    named = os.environ.get(VARIABLE)
    if not named:
        try:
            usual = Path(platformdirs.user_cache_dir("dmframe", appauthor=False))
        except RuntimeError:
            usual = Path()
        if not usual.is_absolute():  # some versions leave a ~ in it
            raise OSError("this user has no home")
        return usual
    try:
        return Path(named).expanduser().absolute()
    except RuntimeError:
        text = "expected a folder, found the home of an unknown user"
        raise ValueFault(text, location=f"{VARIABLE}={named}") from None


def key_of(source: str, compiler: Compiler) -> str:
    """What the machine code is made from, as one number."""
    told = "\0".join((source, repr((SHARED, FLAGS)), compiler.identity, processor()))
    return hashlib.sha256(encoded(told)).hexdigest()[:40]


def find(folder: Path, key: str) -> Path | None:
    """The entry of a key, whole and our own; what only looks like it is removed."""
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
    """Compile an entry into the cache; `works` is asked of the library before it is kept.

    Raises
    ------
    OSError
        The folder cannot be written.
    CompileFailed
        The compiler refused, or the disk is full, or the library does not work.
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
    """Compile in a folder of one's own. Raises `CompileFailed`, also for a library that does not work."""
    text, library = place / "loop.c", place / "loop.so"
    text.write_text(source, encoding="utf-8")
    compiler.build(text, library)
    if not works(library):
        raise CompileFailed(f"{compiler.command[0]} made a library that does not work")
    return library


def prepare(folder: Path) -> None:
    """Make the cache's folder; one in which others may write is none of ours: they could exchange what was checked.

    Raises
    ------
    OSError
        It cannot be made, or belongs to others.
    """
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    if _foreign(folder.stat()):
        raise OSError("others may write there")


def _name(key: str, content: bytes) -> str:
    return f"{key}-{hashlib.sha256(content).hexdigest()[:40]}.so"


def _ours(path: Path) -> bool:
    """Machine code runs with the user's rights: nobody else may have written it."""
    return path.is_file() and not path.is_symlink() and not _foreign(path.lstat())


def _foreign(told: os.stat_result) -> bool:
    """True for what others may have written."""
    return hasattr(os, "getuid") and bool(told.st_uid not in (os.getuid(), 0) or told.st_mode & 0o022)


@contextmanager
def _working(folder: Path) -> Iterator[Path]:
    place = Path(tempfile.mkdtemp(prefix=_PART, dir=folder))
    try:
        yield place
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _evict(folder: Path, kept: Path, most: int) -> None:
    """Hold the cache within its size, and clear away what killed processes left."""
    now, entries = time.time(), list[tuple[float, int, Path]]()
    with contextlib.suppress(OSError):
        for path in folder.iterdir():
            with contextlib.suppress(OSError):  # another process may be clearing, too
                told = path.stat()
                if path.name.startswith(_PART) and now - told.st_mtime > STALE:
                    shutil.rmtree(path, ignore_errors=True)
                elif path.suffix == ".so" and path != kept:
                    entries.append((told.st_mtime, told.st_size, path))
        room = most - kept.stat().st_size
        for _, size, path in sorted(entries, reverse=True):
            room -= size
            if room < 0:
                with contextlib.suppress(OSError):
                    path.unlink()


__all__ = ["CompileFailed", "Works", "built", "cache_folder", "find", "key_of", "make", "prepare"]
