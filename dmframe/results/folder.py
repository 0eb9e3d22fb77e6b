"""A folder of results: all of it, or nothing."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import shutil
import sys
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, final

from dmframe.config.graph import Graph
from dmframe.errors import OutputError
from dmframe.results.resolved import companions, resolved_text, robot_source
from dmframe.results.summary import summary
from dmframe.simulate import Run

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


@final
@dataclass(frozen=True)
class Result:
    """A graph and its run."""

    graph: Graph
    run: Run


def reserve(path: str | Path) -> Path:
    """Check, before a long simulation, that results can be written to the folder `path`.

    Raises
    ------
    OutputError
        It exists and is not empty, or is no folder, or cannot be written.
    """
    path = Path(path)
    with _told(path):
        if path.is_dir():
            if any(path.iterdir()):
                raise OutputError(
                    f"{path}: expected an empty or a new folder, found one with files; name another folder"
                )
        elif path.exists() or path.is_symlink():
            raise OutputError(f"{path}: expected a folder, found a file; name another folder")
        trial = next(parent for parent in path.absolute().parents if parent.exists()) / f".{uuid.uuid4().hex}"
        trial.mkdir()
        trial.rmdir()
    return path


def write_run(
    path: str | Path,
    results: Sequence[Result],
    *,
    plots: bool = True,
    seed: int | None = None,
    command: Sequence[str] | None = None,
    now: datetime | None = None,
) -> list[dict[str, Any]]:
    """Write runs to a new folder, and return their summaries.

    One graph's files lie in the folder itself, several graphs' in a folder for each; figures, in which they are
    overlaid, lie in the folder itself. Everything is built beside it and then renamed, so that it is there in
    full or not at all.

    Parameters
    ----------
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
    path = reserve(path)
    folders = _folders(path, results)
    summaries = [summary(r.graph.name, r.run, str(folder)) for r, folder in zip(results, folders, strict=True)]
    with _built(path) as building:
        for result, folder, told in zip(results, folders, summaries, strict=True):
            place = building / folder.relative_to(path)
            place.mkdir(exist_ok=True)
            _write_one(place, result, told, seed, command, now)
        if plots:
            from dmframe.results.figures import save_figures

            save_figures(dict(zip(_names(results), (r.run for r in results), strict=True)), building)
    return summaries


def _names(results: Sequence[Result]) -> list[str]:
    """The graphs' names, made distinct."""
    names = list[str]()
    for result in results:
        name, count = result.graph.name, 2
        while name in names:
            name, count = f"{result.graph.name}_{count}", count + 1
        names.append(name)
    return names


def _folders(path: Path, results: Sequence[Result]) -> list[Path]:
    return [path] if len(results) == 1 else [path / name for name in _names(results)]


def _write_one(
    place: Path,
    result: Result,
    told: dict[str, Any],
    seed: int | None,
    command: Sequence[str] | None,
    now: datetime | None,
) -> None:
    text = resolved_text(result.graph)
    (place / "graph.yaml").write_text(text, encoding="utf-8")
    for name, source in companions(result.graph).items():
        shutil.copyfile(source, place / name)
    _write_json(place / "summary.json", told)
    made = provenance(result.graph, text, seed=seed, command=command, now=now)
    # of the diagram that ran, not of the graph: what `verify --json` says of the same loop is the same
    _write_json(place / "provenance.json", {**made, "field_hash": result.run.diagram.fingerprint})
    _write_signals(place / "signals.nc", result, seed)


def _write_signals(file: Path, result: Result, seed: int | None) -> None:
    from dmframe.results.dataset import dataset

    data = dataset(result.run, result.graph, seed)
    packed = {str(name): {"zlib": True, "complevel": 1, "shuffle": True} for name in data.data_vars}
    # in memory first: on a full disk HDF5 itself prints tracebacks and can take the process down
    file.write_bytes(data.to_netcdf(engine="h5netcdf", encoding=packed))


def _write_json(file: Path, data: dict[str, Any]) -> None:
    file.write_text(json.dumps(data, indent=2, allow_nan=False, ensure_ascii=False) + "\n", encoding="utf-8")


def provenance(
    graph: Graph,
    text: str,
    *,
    seed: int | None = None,
    command: Sequence[str] | None = None,
    now: datetime | None = None,
) -> dict[str, Any]:
    """What it takes to have the same run again: versions, machine, command, time, digests, seed."""
    source = robot_source(graph)
    return {
        "time": (now or datetime.now(UTC)).astimezone(UTC).isoformat(timespec="seconds"),
        "command": list(sys.argv if command is None else command),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "versions": {name: _version(name) for name in _PACKAGES},
        "graph_sha256": hashlib.sha256(text.encode()).hexdigest(),
        "robot": graph.robot.name if graph.robot is not None else None,
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
def _built(path: Path) -> Iterator[Path]:
    """A folder beside `path` that takes its place when all went well, and vanishes when not."""
    made = list[Path]()
    building = path.absolute().parent / f".{path.name}.{uuid.uuid4().hex[:8]}.part"
    with _told(path):
        try:
            missing = [parent for parent in path.absolute().parents if not parent.exists()]
            for parent in reversed(missing):
                parent.mkdir()
                made.append(parent)
            building.mkdir()
            yield building
            os.rename(building, path)  # noqa: PTH104 - Path.rename would do the same; this one replaces an empty folder
        except BaseException:
            shutil.rmtree(building, ignore_errors=True)
            for parent in reversed(made):
                with contextlib.suppress(OSError):
                    parent.rmdir()
            raise


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """A fault of the operating system as one that names the folder."""
    try:
        yield
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        hint = "free some space, or name a folder on another disk" if "space" in reason else "name another folder"
        raise OutputError(f"{path}: the results cannot be written: {reason}; {hint}") from error
