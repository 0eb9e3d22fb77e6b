"""A compiled loop in this process."""

from __future__ import annotations

import ctypes
import shutil
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, final

from dmframe.build.cache import CompileFailed, Works, built, cache_folder, find, key_of, make, prepare
from dmframe.build.compiler import Compiler, find_compiler, wanted_compiler

NONE = (
    "no C compiler was found ($CC, cc, gcc, clang, or the package ziglang): the run is interpreted, with the same "
    "numbers to rounding, some thirty times slower"
)
UNAVAILABLE = "the compiled engine is not available: {}; the run is interpreted, some thirty times slower"


@final
@dataclass(frozen=True)
class Loaded:
    """A library, or why there is none; `notice` may also tell of a cache that cannot be used."""

    library: ctypes.CDLL | None
    notice: str | None = None


def load(source: str, works: Works = lambda _: True) -> Loaded:
    """The library of a C source: from the cache, or compiled now; then `works` is asked of it before it is loaded.

    Raises `ValueFault` where an environment variable, ``$CC`` or ``$DMFRAME_CACHE``, cannot be meant.
    """
    compiler = find_compiler()
    if compiler is None:
        return Loaded(None, NONE)
    try:
        loaded = _loaded(source, compiler, cache_folder(), works)
    except OSError as error:
        loaded = _without_cache(source, compiler, "", error, works)
    wanted = wanted_compiler()
    if wanted and shutil.which(wanted[0]) is None:
        told = f"$CC, {wanted[0]}, was not found: compiled by {compiler.command[0]}"
        return Loaded(loaded.library, "; ".join(filter(None, (told, loaded.notice))))
    return loaded


def first_time(notice: str) -> bool:
    """True for what this process has not told yet."""
    told = _told()
    fresh = notice not in told
    told.add(notice)
    return fresh


@cache
def _told() -> set[str]:
    return set()


_kept: dict[tuple[str, Compiler, Path], Loaded] = {}
"""Libraries of this process."""


def _loaded(source: str, compiler: Compiler, folder: Path, works: Works) -> Loaded:
    known = (source, compiler, folder)
    if known not in _kept:
        _kept[known] = _found(source, compiler, folder, works)
    return _kept[known]


def _found(source: str, compiler: Compiler, folder: Path, works: Works) -> Loaded:
    key = key_of(source, compiler)
    try:
        prepare(folder)
        entry = find(folder, key)
        if entry is not None and (library := _opened(entry)) is not None:
            return Loaded(library)
        library = _opened(make(folder, key, source, compiler, works))
    except CompileFailed as error:
        return Loaded(None, UNAVAILABLE.format(error))
    except OSError as error:
        return _without_cache(source, compiler, f" {folder}", error, works)
    return Loaded(library, None if library is not None else UNAVAILABLE.format("its library cannot be loaded"))


def _opened(entry: Path) -> ctypes.CDLL | None:
    """The library; None where it has just been evicted, or does not fit this system."""
    try:
        return ctypes.CDLL(str(entry))
    except OSError:
        entry.unlink(missing_ok=True)
        return None


def _without_cache(source: str, compiler: Compiler, folder: str, why: Exception, works: Works) -> Loaded:
    """Compile for this process alone: the system keeps what is loaded, even when its file is gone."""
    try:
        with tempfile.TemporaryDirectory(prefix="dmframe-") as place:
            library = ctypes.CDLL(str(built(Path(place), source, compiler, works)))
    except (OSError, CompileFailed) as error:
        return Loaded(None, UNAVAILABLE.format(error))
    reason = getattr(why, "strerror", None) or str(why)
    return Loaded(library, f"the cache{folder} cannot be used ({str(reason).lower()}): compiled for this process alone")


def address(array: Any) -> ctypes.c_void_p:
    """Where an array's numbers lie."""
    return ctypes.c_void_p(array.ctypes.data)
