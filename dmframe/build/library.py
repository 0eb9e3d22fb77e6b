"""Compiled libraries loaded into this process."""

from __future__ import annotations

import ctypes
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from dmframe.build.cache import Works, built, cache_folder, find, key_of, make, prepare
from dmframe.build.compiler import CompileFailed, Compiler, find_compiler, wanted_compiler

NONE = (
    "no C compiler was found ($CC, cc, gcc, clang, or the package ziglang): the run is interpreted, with the same "
    "numbers to rounding, about thirty times slower"
)
UNAVAILABLE = "the compiled engine is not available: {}; the run is interpreted, about thirty times slower"


@final
@dataclass(frozen=True)
class Loaded:
    """A library, or None; `notice` has the reason, or reports an unusable cache."""

    library: ctypes.CDLL | None
    notice: str | None = None


def load(source: str, works: Works = lambda _: True) -> Loaded:
    """Library of a C source, from the cache, or compiled and tested by `works`.

    Raises `ValueFault` for an invalid environment variable, ``$CC`` or ``$DMFRAME_CACHE``.
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
        missing = f"$CC, {wanted[0]}, was not found: compiled by {compiler.command[0]}"
        return Loaded(loaded.library, "; ".join(filter(None, (missing, loaded.notice))))
    return loaded


_reported = set[str]()


def first_time(notice: str) -> bool:
    """True at the first call with this notice in this process."""
    fresh = notice not in _reported
    _reported.add(notice)
    return fresh


_kept: dict[tuple[str, Compiler, Path], Loaded] = {}
"""Libraries that this process has loaded."""


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
    """The library; None if it has just been evicted, or does not fit this system."""
    try:
        return ctypes.CDLL(str(entry))
    except OSError:
        entry.unlink(missing_ok=True)
        return None


def _without_cache(source: str, compiler: Compiler, folder: str, why: Exception, works: Works) -> Loaded:
    """Compile for this process only; a loaded library stays usable after its file is deleted."""
    try:
        with tempfile.TemporaryDirectory(prefix="dmframe-") as place:
            library = ctypes.CDLL(str(built(Path(place), source, compiler, works)))
    except (OSError, CompileFailed) as error:
        return Loaded(None, UNAVAILABLE.format(error))
    reason = getattr(why, "strerror", None) or str(why)
    return Loaded(library, f"the cache{folder} cannot be used ({str(reason).lower()}): compiled for this process only")


def bound(function: Any, *arrays: Any) -> Callable[[], int]:
    """Call of a C function with the addresses of arrays, which the call keeps alive; returns its int, if it has one."""
    function.restype = ctypes.c_int
    addresses = tuple(map(address, arrays))

    def call(kept: Any = arrays) -> int:
        return int(function(*addresses))

    return call


def address(array: Any) -> ctypes.c_void_p:
    """Address of an array's data."""
    return ctypes.c_void_p(array.ctypes.data)
