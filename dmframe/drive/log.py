"""Reader of the record of a drive or a run, with a check of its digests."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from dmframe.common.errors import MissingError
from dmframe.common.seal import SEAL, faults, folder_of, seal_of
from dmframe.results.place import SAMPLES
from dmframe.runtime.journal import read_samples

SIGNALS: Final = "signals.nc"


@final
@dataclass(frozen=True, eq=False)
class Log:
    """Record of a drive or a run.

    Parameters
    ----------
    values
        Label -> rows of numbers.
    drive
        Options of the drive; empty for a simulation, and for a record of an earlier version.
    engine
        Engine that computed the commands; empty if unknown.
    signals
        Labels of all signals of the record.
    notices
        Why the record could not be checked against its digests.
    """

    values: Mapping[str, np.ndarray]
    drive: Mapping[str, Any]
    engine: str
    signals: Sequence[str]
    notices: tuple[str, ...]


def read_log(path: Path, needed: Sequence[str], known: Sequence[str], fields: Mapping[str, str]) -> Log:
    """Read the `needed` signals, and those of the `known` ones that the record has.

    Parameters
    ----------
    fields
        For each signal of the robot the field of a sample, ``{"arm.q": "q"}``.

    Raises
    ------
    MissingError
        There is no such file, it lacks a needed signal, or a file of its folder was changed.
    """
    file = path / SIGNALS if path.is_dir() else path
    samples = file if file.suffix == ".bin" else file.with_name(SAMPLES)
    if samples.is_file():  # a long drive, or one that was not completed
        return _from_samples(samples, needed, fields)
    try:
        content = file.read_bytes()
    except OSError:
        raise MissingError(f"expected a folder of results, or its {SIGNALS}, found none", location=str(path)) from None
    notices = _checked(file)
    return _parsed(content, file, needed, known, notices)


def _from_samples(file: Path, needed: Sequence[str], fields: Mapping[str, str]) -> Log:
    """Read the samples that were written during a drive."""
    notices = _checked(file)
    try:
        head, columns = read_samples(file)
        own, drive, engine = str(head["command"]), dict(head["drive"]), str(head["engine"])
        time, sent, command = columns["reference"][:, 0], columns["sent"], columns["command"]
        extra = {f"robot.{name}": columns[name] for name in ("time", "scale", "missed")}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        text = f"expected a record of dmframe, found another file, or a damaged one: {error}"
        raise MissingError(text, location=str(file)) from None
    values = {label: columns[name] for label, name in fields.items() if name in columns}
    values |= {name.partition(":")[2]: rows for name, rows in columns.items() if name.startswith("state:")}
    values |= {"time": time, own: command, "robot.sent": sent, **extra}
    if lacking := [name for name in needed if name not in values]:
        text = f"expected a record with {lacking[0]}, which this controller needs, found none"
        raise MissingError(text, location=str(file))
    return Log(values, drive, engine, list(values), notices)


def _checked(file: Path) -> tuple[str, ...]:
    """Check a file's seal, and return notices. Raises `MissingError` if a digest does not match."""
    folder = folder_of(file)
    if folder is None:
        return (f"{file} has no {SEAL}: it is incomplete or older, and cannot be checked for changes",)
    if broken := faults(folder):
        more = f"; and {len(broken) - 1} more" if len(broken) > 1 else ""
        raise MissingError(f"expected unchanged files: {broken[0]}{more}", location=str(folder))
    seal = seal_of(folder)
    assert seal is not None  # `faults` has read it
    if file.resolve().relative_to(folder.resolve()).as_posix() not in seal.files:
        return (f"{file} is not among the files of {SEAL}, and cannot be checked for changes",)
    return () if seal.complete else (f"{folder} is incomplete: its writer was stopped before the last file",)


def _parsed(content: bytes, file: Path, needed: Sequence[str], known: Sequence[str], notices: tuple[str, ...]) -> Log:
    import h5netcdf

    try:
        with h5netcdf.File(io.BytesIO(content), "r") as opened:
            there = list(opened.variables)
            lacking = [name for name in ("time", *needed) if name not in there]
            if lacking:
                text = f"expected a record with {lacking[0]}, which this controller needs, found none"
                raise MissingError(text, location=str(file))
            wanted = dict.fromkeys(("time", *needed, *(name for name in known if name in there)))
            values = {name: np.array(opened.variables[name][...]) for name in wanted}
            drive, engine = json.loads(str(opened.attrs.get("drive", "{}"))), str(opened.attrs.get("engine", ""))
            return Log(values, dict(drive), engine, there, notices)
    except MissingError:
        raise
    except Exception:  # h5netcdf raises various exceptions for other files
        raise MissingError("expected a record of dmframe, found another file", location=str(file)) from None
