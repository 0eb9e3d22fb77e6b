"""A folder of results: all of it, or nothing."""

from __future__ import annotations

import hashlib
import json
import platform
import re
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

from dmframe.config.experiment import Experiment
from dmframe.errors import OutputError
from dmframe.files import encoded, told_apart, write_bytes, writing
from dmframe.plotting import FORMATS, checked_formats
from dmframe.results import figures
from dmframe.results.dataset import netcdf
from dmframe.results.place import SAMPLES, Place, built, clear_figures, complete, reserved
from dmframe.results.ran import Ran
from dmframe.results.resolved import companions, resolved_text, robot_source
from dmframe.results.summary import summary_of

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


def write_run(
    path: str | Path | Place,
    runs: Sequence[Ran],
    *,
    plots: bool = True,
    formats: Sequence[str] = FORMATS[:1],
    force: bool = False,
    seed: int | None = None,
    command: Sequence[str] | None = None,
    now: datetime | None = None,
) -> list[dict[str, Any]]:
    """Write runs to a new folder, and return their summaries.

    One graph's files lie in the folder itself, several graphs' in a folder for each; figures, in which they are
    overlaid, lie in the folder itself. Data are built in a hidden folder and moved when they are whole, so that they
    are there in full or not at all. Figures come after them: what cannot be drawn loses nothing.

    Parameters
    ----------
    path
        A new or an empty folder, or one held by `reserved`.
    plots
        Draw the figures.
    formats
        In which: ``svg``, ``png``, ``pdf``.
    force
        The folder may hold files; those of the same names are replaced.
    seed
        Of the runs' noise, for the record.
    command, now
        The command line and the time that the record states; by default those of this process.

    Raises
    ------
    OutputError
        The folder has files in it, or cannot be written.
    """
    folders = folders_of([run.name for run in runs])
    held = nullcontext(path) if isinstance(path, Place) else reserved(path, force=force, folders=folders)
    with held as place, drawing(runs if plots else (), checked_formats("formats", formats)) as draw:
        summaries = write_data(place, runs, seed=seed, command=command, now=now)
        draw(place)
        complete(place)
    return summaries


def write_data(
    place: Place,
    runs: Sequence[Ran],
    *,
    seed: int | None = None,
    command: Sequence[str] | None = None,
    now: datetime | None = None,
) -> list[dict[str, Any]]:
    """All of `write_run` but the figures and the note, `complete`, that nothing is still to come."""
    below = folders_of([run.name for run in runs])
    folders = [place.path / name for name in below] or [place.path]
    summaries = [{**summary_of(run, str(folder)), "graph": run.name} for run, folder in zip(runs, folders, strict=True)]
    with built(place) as building:
        for run, folder, told in zip(runs, folders, summaries, strict=True):
            own = building / folder.relative_to(place.path)
            own.mkdir(exist_ok=True)
            _write_one(own, run, told, seed, command, now)
    with writing(place.path, "folder"):
        clear_figures(place.folder)
        if all(run.recording.drive.get("every", 1) == 1 for run in runs):  # signals.nc holds every sample
            (place.folder / SAMPLES).unlink(missing_ok=True)
    return summaries


@contextmanager
def drawing(runs: Sequence[Ran], formats: Sequence[str]) -> Iterator[Callable[[Place], None]]:
    """Begin to draw figures; what is yielded writes them beside their data.

    That raises `OutputError` where it cannot be done; where it is not called, there are none.
    """
    with figures.drawing(dict(zip(_names([run.name for run in runs]), runs, strict=True)), formats) as drawn:

        def write(place: Place) -> None:
            try:
                with writing(place.path, "figures"):
                    for name, content in drawn().items():
                        write_bytes(place.folder / name, content)
            except OutputError:
                raise
            except Exception as error:  # whatever a plotting library raises at names and numbers of others
                reason = (str(error).splitlines() or [""])[0]
                raise OutputError(
                    f"{place.path}: signals and summary are written, the figures are not: "
                    f"{type(error).__name__}: {reason}"
                ) from error

        yield write


def safe_name(name: str) -> str:
    """A graph's name as that of a folder on any system: letters, digits, - and _.

    Without a dot, it is no figure's file.
    """
    return re.sub(r"[^\w-]", "_", name).strip("_-").encode()[:_LONGEST].decode(errors="ignore") or "graph"


def folders_of(labels: Sequence[str]) -> list[str]:
    """The folders in a folder of results, one a run; none where there is one run alone, whose files lie in it."""
    return _names(labels) if len(labels) > 1 else []


def _names(labels: Sequence[str]) -> list[str]:
    """Names for the graphs' folders and curves."""
    return told_apart(map(safe_name, labels), lambda name, count: f"{name}_{count}")


def _write_one(
    place: Path,
    run: Ran,
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
    # of the diagram that ran, not of the graph: what `verify --json` says of the same loop is the same
    field_hash = run.recording.diagram.fingerprint
    made = provenance(run.experiment, text, field_hash=field_hash, seed=seed, command=command, now=now)
    if run.recording.drive:
        made["drive"] = dict(run.recording.drive)
    _write_json(place / "provenance.json", made)
    _write_signals(place / "signals.nc", run, seed)


def _write_signals(file: Path, run: Ran, seed: int | None) -> None:
    file.write_bytes(netcdf(run.whole, run.experiment, seed))


def _write_json(file: Path, data: dict[str, Any]) -> None:
    file.write_bytes(encoded(json.dumps(data, indent=2, allow_nan=False, ensure_ascii=False) + "\n"))


def provenance(
    experiment: Experiment,
    text: str,
    *,
    field_hash: str,
    seed: int | None = None,
    command: Sequence[str] | None = None,
    now: datetime | None = None,
) -> dict[str, Any]:
    """What it takes to have the same run again: versions, machine, command, time, digests, seed; and the model's hash,
    `Diagram.fingerprint`.
    """
    source = robot_source(experiment)
    return {
        "time": (now or datetime.now(UTC)).astimezone(UTC).isoformat(timespec="seconds"),
        "command": list(sys.argv if command is None else command),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "versions": {name: _version(name) for name in _PACKAGES},
        "graph_sha256": hashlib.sha256(encoded(text)).hexdigest(),
        "field_hash": field_hash,
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
