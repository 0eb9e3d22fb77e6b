"""Write a results folder atomically: signals, graph, summary, provenance, figures."""

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
from functools import partial
from pathlib import Path
from typing import Any, Final

from dmframe.common.errors import OutputError
from dmframe.common.files import encoded, made_distinct, write_bytes, writing
from dmframe.common.plotting import FORMATS, checked_formats
from dmframe.common.version import version_of
from dmframe.config import BaseGraph
from dmframe.config.resolved import companions, resolved_text, robot_source
from dmframe.results.dataset import netcdf
from dmframe.results.drawing_process import Drawing, drawing_of
from dmframe.results.place import SAMPLES, Place, built, clear_figures, complete, reserved
from dmframe.results.run import Run
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
"""Maximum bytes of a graph's name in a file name; file systems allow 255."""


def write_run(
    path: str | Path | Place,
    runs: Sequence[Run],
    *,
    plots: bool = True,
    formats: Sequence[str] = FORMATS[:1],
    force: bool = False,
) -> list[dict[str, Any]]:
    """Write runs to a new folder, and return their summaries.

    The files of one graph are in the folder itself, those of several graphs in subfolders; overlaid figures are in the
    folder itself. Data are built in a hidden folder and moved when complete. Figures are written after them, so that a
    plotting error loses no data.

    Parameters
    ----------
    path
        A new or empty folder, or one locked by `reserved`.
    plots
        Draw the figures.
    formats
        Formats of the figures: ``svg``, ``png``, ``pdf``.
    force
        Allow a folder with files; those of the same names are replaced.

    Raises
    ------
    OutputError
        If the folder is not empty or cannot be written.
    """
    folders = folders_of([run.name for run in runs])
    reservation = nullcontext(path) if isinstance(path, Place) else reserved(path, force=force, folders=folders)
    with reservation as place, drawing(runs if plots else (), checked_formats("formats", formats)) as draw:
        summaries = write_data(place, runs)
        draw(place, runs)
        complete(place)
    return summaries


def write_data(place: Place, runs: Sequence[Run]) -> list[dict[str, Any]]:
    """`write_run` without the figures and the final seal of `complete`."""
    below = folders_of([run.name for run in runs])
    folders = [place.path / name for name in below] or [place.path]
    summaries = [{**summary_of(run, str(folder)), "graph": run.name} for run, folder in zip(runs, folders, strict=True)]
    with built(place) as building:
        for run, folder, data in zip(runs, folders, summaries, strict=True):
            own = building / folder.relative_to(place.path)
            own.mkdir(exist_ok=True)
            _write_one(own, run, data)
    with writing(place.path, "folder"):
        clear_figures(place.folder)
        if all(run.recording.drive.get("every", 1) == 1 for run in runs):  # signals.nc contains every sample
            (place.folder / SAMPLES).unlink(missing_ok=True)
    return summaries


@contextmanager
def drawing(runs: Sequence[Run], formats: Sequence[str]) -> Iterator[Callable[[Place, Sequence[Run]], None]]:
    """Start drawing figures; yields a function that writes them next to the data, or raises `OutputError`."""
    with drawing_of(named(runs), formats) as drawn:
        yield partial(write_figures, drawn)


def write_figures(drawn: Drawing, place: Place, known: Sequence[Run]) -> None:
    """Write the figures next to the data, or raise `OutputError`."""
    try:
        with writing(place.path, "figures"):
            for name, content in drawn.files(named(known)).items():
                write_bytes(place.folder / name, content)
    except OutputError:
        raise
    except Exception as error:  # plotting libraries raise various errors for user names and values
        reason = (str(error).splitlines() or [""])[0]
        raise OutputError(
            f"{place.path}: signals and summary are written, the figures are not: {type(error).__name__}: {reason}"
        ) from error


def named(runs: Sequence[Run]) -> dict[str, Run]:
    """Runs by the names of their curves."""
    return dict(zip(_names([run.name for run in runs]), runs, strict=True))


def safe_name(name: str) -> str:
    """Portable folder name of a graph: letters, digits, - and _, no dot, which distinguishes it from a figure file."""
    return re.sub(r"[^\w-]", "_", name).strip("_-").encode()[:_LONGEST].decode(errors="ignore") or "graph"


def folders_of(labels: Sequence[str]) -> list[str]:
    """Subfolders of several runs; empty for a single run."""
    return _names(labels) if len(labels) > 1 else []


def _names(labels: Sequence[str]) -> list[str]:
    """Distinct names of folders and curves."""
    return made_distinct(map(safe_name, labels), lambda name, count: f"{name}_{count}")


def _write_one(place: Path, run: Run, data: dict[str, Any]) -> None:
    text = resolved_text(run.graph)
    (place / "graph.yaml").write_bytes(encoded(text))
    for name, source in companions(run.graph).items():
        shutil.copyfile(source, place / name)
    _write_json(place / "summary.json", data)
    # hash of the diagram that ran, not of the graph, as in `verify --json`
    field_hash = run.recording.diagram.fingerprint
    made = provenance(run.graph, text, field_hash=field_hash, seed=run.graph.file.seed)
    if run.recording.drive:
        made["drive"] = dict(run.recording.drive)
    _write_json(place / "provenance.json", made)
    (place / "signals.nc").write_bytes(netcdf(run.whole, run.graph))


def _write_json(file: Path, data: dict[str, Any]) -> None:
    file.write_bytes(encoded(json.dumps(data, indent=2, allow_nan=False, ensure_ascii=False) + "\n"))


def provenance(
    graph: BaseGraph,
    text: str,
    *,
    field_hash: str,
    seed: int | None = None,
    command: Sequence[str] | None = None,
) -> dict[str, Any]:
    """Data to reproduce a run: versions, machine, command, time, digests, seed, model hash `Diagram.fingerprint`."""
    source = robot_source(graph)
    return {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": list(sys.argv if command is None else command),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "versions": {name: version_of(name) for name in _PACKAGES},
        "graph_sha256": hashlib.sha256(encoded(text)).hexdigest(),
        "field_hash": field_hash,
        "robot": graph.robot.name if graph.robot is not None else None,
        "urdf": source.urdf.name if source else None,
        "urdf_sha256": hashlib.sha256(source.urdf.read_bytes()).hexdigest() if source else None,
        "seed": seed,
    }
