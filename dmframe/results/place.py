"""Results folder of a run: locked during the run and filled atomically."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, final

from dmframe.common.errors import OutputError
from dmframe.common.files import flocked, hidden_name, is_hidden, sync, sync_below, write_text, writing
from dmframe.common.plotting import FORMATS
from dmframe.common.seal import SEAL, BrokenSeal, FolderSeal, digest_of, seal_of

SAMPLES: Final = "samples.bin"
"""Every sample of a drive; kept after a long one."""
FILES: Final = ("graph.yaml", "provenance.json", SAMPLES, SEAL, "signals.nc", "summary.json")
PAGE: Final = "page.html"
FIGURES: Final = ("error", "path", "commands", "effort")
OF_EACH: Final = ("storage", "estimates")
"""Figures by run; with several runs ``estimates_<name>``."""


@final
@dataclass(frozen=True)
class Place:
    """Folder reserved for results.

    Parameters
    ----------
    path, folder
        Path given by the user, and resolved path.
    new
        True for a folder that was created.
    reserved
        The folder that was reserved; another one may have its path by the time of writing.
    locks
        File locks until release, including those of a folder renamed to this one.
    """

    path: Path
    folder: Path
    new: bool
    reserved: os.stat_result | None = field(default=None, compare=False, repr=False)
    locks: list[int] = field(default_factory=list, compare=False, repr=False)

    def release(self) -> None:
        """Close the file locks."""
        while self.locks:
            os.close(self.locks.pop())


@contextmanager
def reserved(path: str | Path, *, force: bool = False, folders: Collection[str] = ()) -> Iterator[Place]:
    """Create and lock a folder for results; created folders that stay empty are removed.

    Used around a long simulation, so that it does not end with an unusable folder.

    Parameters
    ----------
    force
        Allow a folder with files; those of the same names will be replaced.
    folders
        Subfolders to which results will be written.

    Raises
    ------
    OutputError
        If the folder is not empty, not a folder, not writable or locked by another run; with `force`, if a file to be
        replaced is not a results file.
    """
    path = Path(path)
    with locked(path) as (folder, is_locked, made):
        with writing(path, "folder"):
            _check_usable(folder, path, folders, ours=is_locked, force=force)
        place = Place(path, folder, folder in made, folder.stat())
        try:
            yield place
        finally:
            place.release()


@contextmanager
def locked(path: Path) -> Iterator[tuple[Path, bool, list[Path]]]:
    """Create and lock a folder; yields its resolved path, whether it is locked, and the new folders.

    New folders that are still empty at the end are removed. Raises `OutputError`.
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
            with contextlib.suppress(OSError):  # not empty
                each.rmdir()


def _make(folder: Path, path: Path, made: list[Path]) -> None:
    """Create a folder with its parents; new ones are appended to `made`."""
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
    """Check that the folder is empty and writable."""
    for item in list(folder.iterdir()):
        if not (ours and is_hidden(item.name)):
            if force:
                _check_replaceable(item, path, folder=item.name in folders)
                continue
            raise OutputError(
                f"{path}: expected an empty or a new folder, found one with files; name another folder, or use --force"
            )
        shutil.rmtree(item)  # of a killed run: this process has the lock
    trial = folder / hidden_name()
    trial.mkdir()
    trial.rmdir()


def is_ours(name: str) -> bool:
    """True for the name of a results file."""
    stem, _, ending = name.rpartition(".")
    return name in (*FILES, PAGE) or (ending in FORMATS and (stem in FIGURES or stem.startswith(OF_EACH)))


def _check_replaceable(item: Path, path: Path, *, folder: bool) -> None:
    """With --force: refuse a folder in place of a results file, and a subfolder without results.

    Other items are replaced or kept.
    """
    real = item.is_dir() and not item.is_symlink()
    if real and is_ours(item.name):
        raise OutputError(
            f"{path}: {item.name} is a folder, but a file has to be written; move it, or name another folder"
        )
    if folder and not real:
        raise OutputError(
            f"{path}: {item.name} is a file, but a folder has to be created; move it, or name another folder"
        )
    if folder and not (item / FILES[0]).is_file() and any(item.iterdir()):
        raise OutputError(f"{path}: the folder {item.name} contains no results; move it, or name another folder")


def clear_figures(folder: Path) -> None:
    """Remove figures (and links) of an earlier run, which do not match the new data."""
    for item in folder.iterdir():
        if is_ours(item.name) and item.name not in FILES and (item.is_symlink() or item.is_file()):
            item.unlink()


def _locked(folder: Path, path: Path) -> int | None:
    """Lock a folder for the life of this process; None on systems without locks."""
    busy = f"{path}: another process writes there; name another folder"
    if (lock := flocked(folder, os.O_RDONLY, busy)) is None:
        return None
    try:
        same = os.path.samestat(os.fstat(lock), folder.stat())
    except FileNotFoundError:
        same = False
    if not same:  # replaced before it was locked
        os.close(lock)
        raise OutputError(busy)
    return lock


@contextmanager
def built(place: Place, *, seal: bool = True) -> Iterator[Path]:
    """Hidden folder that replaces `place` on success and is removed on failure; its files are synced to the disk first.

    It is inside an existing `place`, since a working directory or a mount point cannot be replaced.

    Parameters
    ----------
    seal
        Write a seal of the data files.
    """
    building, moved = (place.folder.parent if place.new else place.folder) / hidden_name(), list[Path]()
    with writing(place.path, "folder"):
        try:
            _check_reserved(place)
            building.parent.mkdir(parents=True, exist_ok=True)
            building.mkdir()
            yield building
            if seal:
                _seal_data(building)
            sync_below(building)
            lock = _locked(building, place.path)  # a lock belongs to a folder, not to its name
            if lock is not None:
                place.locks.append(lock)
            with contextlib.suppress(OSError):
                os.rename(building, place.folder)  # noqa: PTH104 - Path.rename would do the same; this one replaces an empty folder
            if not building.exists():
                sync(place.folder.parent)
                return
            if seal:
                (place.folder / SEAL).unlink(missing_ok=True)  # none until all files are moved
            for item in sorted(building.iterdir(), key=lambda item: item.name == SEAL):
                target = place.folder / item.name
                if target.exists() or target.is_symlink():  # with --force, or created meanwhile
                    _check_replaceable(target, place.path, folder=item.is_dir())
                if target.is_dir() and not target.is_symlink():  # earlier results
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


def _check_reserved(place: Place) -> None:
    """Check that the folder is the reserved one, a missing one, or has only a record. Raises `OutputError` if not."""
    try:
        same = place.reserved is None or os.path.samestat(place.reserved, place.folder.stat())
        items = set() if same else {item.name for item in place.folder.iterdir()}
    except FileNotFoundError:
        return
    if items - {SAMPLES}:
        raise OutputError(f"{place.path}: expected the folder that was reserved, found another one with files")


def _seal_data(folder: Path) -> None:
    """Seal the data files; figures and pages are added by `complete`."""
    files = {path.relative_to(folder).as_posix(): digest_of(path) for path in folder.rglob("*") if path.is_file()}
    (folder / SEAL).write_text(FolderSeal(files, complete=False).text, encoding="utf-8")


def complete(place: Place) -> None:
    """Write the final seal with the digests of all files, figures and pages included.

    Raises
    ------
    OutputError
        If it cannot be written, or the seal of the data is missing.
    """
    try:
        seal = seal_of(place.folder)
    except BrokenSeal as error:
        raise OutputError(f"{place.path}: {error}") from None
    if seal is None:
        raise OutputError(f"{place.path}: {SEAL}, written with the data, is missing")
    files = dict(seal.files)
    for folder in {place.folder, *((place.folder / name).parent for name in seal.files)}:
        for item in folder.iterdir():
            name = item.relative_to(place.folder).as_posix()
            if name not in files and is_ours(item.name) and item.name != SEAL and item.is_file():
                files[name] = digest_of(item)
    write_text(place.folder / SEAL, FolderSeal(files, complete=True).text)
