"""The folder of a run's results: held while the run lasts, and filled in one step."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, final

from dmframe.errors import OutputError
from dmframe.files import hidden_name, is_hidden, sync, sync_below, write_text, writing
from dmframe.plotting import FORMATS
from dmframe.seal import SEAL, BrokenSeal, FolderSeal, digest_of, seal_of

SAMPLES: Final = "samples.bin"
"""Every sample of a drive: while it lasts, and of a long one for good."""
FILES: Final = ("graph.yaml", "provenance.json", SAMPLES, SEAL, "signals.nc", "summary.json")
PAGE: Final = "page.html"
FIGURES: Final = ("error", "path", "commands", "effort")
OF_EACH: Final = ("storage", "estimates")
"""Figures of one run: of several runs each has its own, ``estimates_<name>``."""


@final
@dataclass(frozen=True)
class Place:
    """A folder that is held for results.

    Parameters
    ----------
    path, folder
        As the user names it, and where it really lies.
    new
        It was made for them.
    locks
        Held until the place is given back: of what was renamed to the folder, too.
    """

    path: Path
    folder: Path
    new: bool
    locks: list[int] = field(default_factory=list, compare=False, repr=False)


@contextmanager
def reserved(path: str | Path, *, force: bool = False, folders: Collection[str] = ()) -> Iterator[Place]:
    """Make and hold a folder for results; where nothing was written to it, what was made goes again.

    A long simulation is held within, so that it does not end in a place that cannot be used.

    Parameters
    ----------
    force
        The folder may hold files; those of the same names will be replaced.
    folders
        Those in it to which results will be written.

    Raises
    ------
    OutputError
        It exists and is not empty, or is no folder, or cannot be written, or another run is about to write there; or,
        with `force`, what would be replaced in it is not ours.
    """
    path = Path(path)
    with held(path) as (folder, locked, made):
        with writing(path, "folder"):
            _check_usable(folder, path, folders, ours=locked, force=force)
        place = Place(path, folder, folder in made)
        try:
            yield place
        finally:
            while place.locks:
                os.close(place.locks.pop())


@contextmanager
def held(path: Path) -> Iterator[tuple[Path, bool, list[Path]]]:
    """Make a folder and lock it; yields where it really lies, whether it is locked, and the folders that are new.

    Of the new folders those that are still empty at the end are removed. Raises `OutputError`.
    """
    made = list[Path]()
    try:
        with writing(path, "folder"):
            folder = Path(os.path.realpath(path))
            _make(folder, path, made)
            lock = _locked(folder, path)
        try:
            yield folder, lock is not None, made
        finally:
            if lock is not None:
                os.close(lock)
    finally:
        for each in reversed(made):
            with contextlib.suppress(OSError):  # results lie there
                each.rmdir()


def _make(folder: Path, path: Path, made: list[Path]) -> None:
    """Make a folder and those above it; the new ones are added to `made`."""
    for each in (*reversed(folder.parents), folder):
        try:
            each.mkdir()
            made.append(each)
        except OSError:
            if not each.is_dir():
                if each == folder and each.exists():
                    raise OutputError(f"{path}: expected a folder, found a file; name another folder") from None
                raise


def _check_usable(folder: Path, path: Path, folders: Collection[str], *, ours: bool, force: bool) -> None:
    """The folder is empty, and what is done at the end can be done."""
    for item in list(folder.iterdir()):
        if not (ours and is_hidden(item.name)):
            if force:
                _check_replaceable(item, path, folder=item.name in folders)
                continue
            raise OutputError(
                f"{path}: expected an empty or a new folder, found one with files; name another folder, or take --force"
            )
        shutil.rmtree(item)  # of a run that was killed, for nobody else holds this folder
    trial = folder / hidden_name()
    trial.mkdir()
    trial.rmdir()


def is_ours(name: str) -> bool:
    """True for the name of a file that a run writes."""
    stem, _, ending = name.rpartition(".")
    return name in (*FILES, PAGE) or (ending in FORMATS and (stem in FIGURES or stem.startswith(OF_EACH)))


def _check_replaceable(item: Path, path: Path, *, folder: bool) -> None:
    """With --force: refuse a folder where a file of ours is to be, and where `folder` is to be what holds no results.

    Anything else is replaced, or stays beside the results.
    """
    real = item.is_dir() and not item.is_symlink()
    if real and is_ours(item.name):
        raise OutputError(f"{path}: {item.name} is a folder, where a file is to be written; move it, or name another")
    if folder and not real:
        raise OutputError(f"{path}: {item.name} is a file, where a folder is to be made; move it, or name another")
    if folder and not (item / FILES[0]).is_file() and any(item.iterdir()):
        raise OutputError(f"{path}: the folder {item.name} holds no results; move it, or name another")


def clear_figures(folder: Path) -> None:
    """Take away an earlier run's figures, links among them: beside new data they would tell another story."""
    for item in folder.iterdir():
        if is_ours(item.name) and item.name not in FILES and (item.is_symlink() or item.is_file()):
            item.unlink()


def _locked(folder: Path, path: Path) -> int | None:
    """Hold a folder as long as this process lives; None where the system cannot."""
    try:
        import fcntl
    except ImportError:
        return None
    lock = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        raise OutputError(f"{path}: another process writes there; name another folder") from None
    except OSError:  # some network drives have no locks
        os.close(lock)
        return None
    try:
        same = os.path.samestat(os.fstat(lock), folder.stat())
    except FileNotFoundError:
        same = False
    if not same:  # its results came between the look at it and the lock
        os.close(lock)
        raise OutputError(f"{path}: another process writes there; name another folder")
    return lock


@contextmanager
def built(place: Place) -> Iterator[Path]:
    """A hidden folder that takes its place when all went well, and vanishes when not.

    In the place itself where that was there before: nothing can be renamed over the working folder or a whole drive.
    """
    building, moved = (place.folder.parent if place.new else place.folder) / hidden_name(), list[Path]()
    with writing(place.path, "folder"):
        try:
            building.mkdir()
            yield building
            _seal_data(building)
            sync_below(building)
            lock = _locked(building, place.path)  # a lock is that of a folder, not of its name
            if lock is not None:
                place.locks.append(lock)
            with contextlib.suppress(OSError):
                os.rename(building, place.folder)  # noqa: PTH104 - Path.rename would do the same; this one replaces an empty folder
            if not building.exists():
                sync(place.folder.parent)
                return
            (place.folder / SEAL).unlink(missing_ok=True)  # until all files are there, there is no seal
            for item in sorted(building.iterdir(), key=lambda item: item.name == SEAL):
                target = place.folder / item.name
                if target.exists() or target.is_symlink():  # --force, and it may have come since
                    _check_replaceable(target, place.path, folder=item.is_dir())
                if target.is_dir() and not target.is_symlink():  # results of before
                    shutil.rmtree(target)
                item.replace(target)
                moved.append(target)
            building.rmdir()
            sync(place.folder)
        except BaseException:
            for item in (building, *moved):
                shutil.rmtree(item, ignore_errors=True)
                with contextlib.suppress(OSError):
                    item.unlink()
            raise


def _seal_data(folder: Path) -> None:
    """Note the digests of all files below, which are not all that will be written."""
    files = {path.relative_to(folder).as_posix(): digest_of(path) for path in folder.rglob("*") if path.is_file()}
    (folder / SEAL).write_text(FolderSeal(files, complete=False).text, encoding="utf-8")


def complete(place: Place) -> None:
    """Note that all is written, with the digests of figures and pages too: the last file of a folder of results.

    Raises
    ------
    OutputError
        It cannot be written, or the data have no seal any more.
    """
    try:
        seal = seal_of(place.folder)
    except BrokenSeal as error:
        raise OutputError(f"{place.path}: {error}") from None
    if seal is None:
        raise OutputError(f"{place.path}: {SEAL} is gone, which was written with the data")
    files = dict(seal.files)
    for folder in {place.folder, *((place.folder / name).parent for name in seal.files)}:
        for item in folder.iterdir():
            name = item.relative_to(place.folder).as_posix()
            if name not in files and is_ours(item.name) and item.name != SEAL and item.is_file():
                files[name] = digest_of(item)
    write_text(place.folder / SEAL, FolderSeal(files, complete=True).text)
