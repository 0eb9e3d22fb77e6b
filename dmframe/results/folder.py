"""A folder of results: all of it, or nothing."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import re
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final, final

from dmframe.config.experiment import Experiment
from dmframe.errors import OutputError
from dmframe.files import encoded, hidden_name, is_hidden, writing
from dmframe.results.resolved import companions, resolved_text, robot_source
from dmframe.results.run import Run
from dmframe.results.summary import summary

_PACKAGES = (
    "dmframe",
    "casadi",
    "control",
    "h5netcdf",
    "h5py",
    "matplotlib",
    "numpy",
    "pin",
    "pydantic",
    "scipy",
    "xarray",
)
_LONGEST: Final = 150
"""Bytes of a graph's name in that of a folder or figure; a file system takes 255."""


@final
@dataclass(frozen=True)
class Place:
    """A folder that is held for results: as the user names it, where it really lies, and was it made for them?"""

    path: Path
    folder: Path
    new: bool


def reserve(path: str | Path) -> Path:
    """Check that results can be written to the folder `path`, and leave nothing behind.

    Raises
    ------
    OutputError
        It exists and is not empty, or is no folder, or cannot be written, or another run is about to write there.
    """
    with reserved(path) as place:
        return place.path


@contextmanager
def reserved(path: str | Path) -> Iterator[Place]:
    """Make and hold a folder for results; where nothing was written to it, what was made goes again.

    Within a long simulation, so that it does not end in a place that cannot be used. Raises what `reserve` raises.
    """
    path, made = Path(path), list[Path]()
    try:
        with writing(path, "folder"):
            folder = Path(os.path.realpath(path))
            _make(folder, path, made)
            lock = _locked(folder, path)
        try:
            with writing(path, "folder"):
                _check_usable(folder, path, ours=lock is not None)
            yield Place(path, folder, folder in made)
        finally:
            if lock is not None:
                os.close(lock)
    finally:
        for each in reversed(made):
            with contextlib.suppress(OSError):  # results lie there
                each.rmdir()


def _make(folder: Path, path: Path, made: list[Path]) -> None:
    """Make a folder and those above it."""
    for each in (*reversed(folder.parents), folder):
        try:
            each.mkdir()
            made.append(each)
        except OSError:
            if not each.is_dir():
                if each == folder and each.exists():
                    raise OutputError(f"{path}: expected a folder, found a file; name another folder") from None
                raise


def _check_usable(folder: Path, path: Path, *, ours: bool) -> None:
    """The folder is empty, and what is done at the end can be done."""
    for item in list(folder.iterdir()):
        if not (ours and is_hidden(item.name)):
            raise OutputError(f"{path}: expected an empty or a new folder, found one with files; name another folder")
        shutil.rmtree(item)  # of a run that was killed, for nobody else holds this folder
    trial = folder / hidden_name()
    trial.mkdir()
    trial.rmdir()


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
        raise OutputError(f"{path}: another run writes there; name another folder") from None
    except OSError:  # some network drives have no locks
        os.close(lock)
        return None
    return lock


def write_run(
    path: str | Path | Place,
    runs: Sequence[Run],
    *,
    plots: bool = True,
    seed: int | None = None,
    command: Sequence[str] | None = None,
    now: datetime | None = None,
) -> list[dict[str, Any]]:
    """Write runs to a new folder, and return their summaries.

    One graph's files lie in the folder itself, several graphs' in a folder for each; figures, in which they are
    overlaid, lie in the folder itself. Everything is built in a hidden folder and moved when it is whole, so that it
    is there in full or not at all.

    Parameters
    ----------
    path
        A new or an empty folder, or one held by `reserved`.
    plots
        Draw the figures.
    seed
        Of the runs' noise, for the record.
    command, now
        The command line and the time that the record states; by default those of this process.

    Raises
    ------
    OutputError
        The folder has files in it, or cannot be written.
    """
    names = _names(runs)
    with nullcontext(path) if isinstance(path, Place) else reserved(path) as place:
        folders = [place.path / name if len(runs) > 1 else place.path for name in names]
        summaries = [summary(run.name, run.recording, str(folder)) for run, folder in zip(runs, folders, strict=True)]
        with _built(place) as building:
            for run, folder, told in zip(runs, folders, summaries, strict=True):
                own = building / folder.relative_to(place.path)
                own.mkdir(exist_ok=True)
                _write_one(own, run, told, seed, command, now)
            if plots:
                from dmframe.results.figures import figures_of

                figures_of(dict(zip(names, (run.recording for run in runs), strict=True))).save(building)
    return summaries


def safe_name(name: str) -> str:
    """A graph's name as that of a folder on any system: letters, digits, - and _.

    Without a dot, it is no figure's file.
    """
    return re.sub(r"[^\w-]", "_", name).strip("_-").encode()[:_LONGEST].decode(errors="ignore") or "graph"


def _names(runs: Sequence[Run]) -> list[str]:
    """Names for the graphs' folders and curves, distinct where capitals are not told apart, too."""
    names = dict[str, str]()
    for run in runs:
        first = name = safe_name(run.name)
        count = 2
        while name.casefold() in names:
            name, count = f"{first}_{count}", count + 1
        names[name.casefold()] = name
    return list(names.values())


def _write_one(
    place: Path,
    run: Run,
    told: dict[str, Any],
    seed: int | None,
    command: Sequence[str] | None,
    now: datetime | None,
) -> None:
    text = resolved_text(run.experiment)
    (place / "graph.yaml").write_bytes(encoded(text))
    for name, source in companions(run.experiment).items():
        shutil.copyfile(source, place / name)
    _write_json(place / "summary.json", told)
    made = provenance(run.experiment, text, seed=seed, command=command, now=now)
    # of the diagram that ran, not of the graph: what `verify --json` says of the same loop is the same
    _write_json(place / "provenance.json", {**made, "field_hash": run.recording.diagram.fingerprint})
    _write_signals(place / "signals.nc", run, seed)


def _write_signals(file: Path, run: Run, seed: int | None) -> None:
    from dmframe.results.dataset import dataset

    data = dataset(run.recording, run.experiment, seed)
    packed = {str(name): {"zlib": True, "complevel": 1, "shuffle": True} for name in data.data_vars}
    # in memory first: on a full disk HDF5 itself prints tracebacks and can take the process down
    file.write_bytes(data.to_netcdf(engine="h5netcdf", encoding=packed))


def _write_json(file: Path, data: dict[str, Any]) -> None:
    file.write_bytes(encoded(json.dumps(data, indent=2, allow_nan=False, ensure_ascii=False) + "\n"))


def provenance(
    experiment: Experiment,
    text: str,
    *,
    seed: int | None = None,
    command: Sequence[str] | None = None,
    now: datetime | None = None,
) -> dict[str, Any]:
    """What it takes to have the same run again: versions, machine, command, time, digests, seed."""
    source = robot_source(experiment)
    return {
        "time": (now or datetime.now(UTC)).astimezone(UTC).isoformat(timespec="seconds"),
        "command": list(sys.argv if command is None else command),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "versions": {name: _version(name) for name in _PACKAGES},
        "graph_sha256": hashlib.sha256(encoded(text)).hexdigest(),
        "robot": experiment.robot.name if experiment.robot is not None else None,
        "urdf": source.urdf.name if source else None,
        "urdf_sha256": hashlib.sha256(source.urdf.read_bytes()).hexdigest() if source else None,
        "seed": seed,
    }


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


@contextmanager
def _built(place: Place) -> Iterator[Path]:
    """A hidden folder that takes its place when all went well, and vanishes when not.

    In the place itself where that was there before: nothing can be renamed over the working folder or a whole drive.
    """
    building, moved = (place.folder.parent if place.new else place.folder) / hidden_name(), list[Path]()
    with writing(place.path, "folder"):
        try:
            building.mkdir()
            yield building
            with contextlib.suppress(OSError):
                os.rename(building, place.folder)  # noqa: PTH104 - Path.rename would do the same; this one replaces an empty folder
                return
            for item in list(building.iterdir()):
                moved.append(item.rename(place.folder / item.name))
            building.rmdir()
        except BaseException:
            for item in (building, *moved):
                shutil.rmtree(item, ignore_errors=True)
                with contextlib.suppress(OSError):
                    item.unlink()
            raise
