"""Columns of a log from the results of ``dmframe drive`` or ``run``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from dmframe.common.errors import MissingError
from dmframe.drive.log import SIGNALS, read_log
from dmframe.results.place import SAMPLES

SENT: Final = "robot.sent"
"""Command after the gate."""
CLOCK: Final = "robot.time"


def is_drive(path: Path) -> bool:
    """True for a folder of results, or its file of signals or samples."""
    if path.is_dir():
        return (path / SIGNALS).is_file() or (path / SAMPLES).is_file()
    return path.suffix == ".nc" or path.name == SAMPLES


def drive_columns(path: Path) -> tuple[Path, dict[str, np.ndarray]]:
    """The file that was read, and time, positions and commands by plain names.

    Raises
    ------
    MissingError
        It is not a record of dmframe, was changed, or lacks positions or velocity commands.
    """
    found = read_log(path, (), (CLOCK, SENT), {"q": "q"})
    if "q" not in found.values:
        q = _only(found.signals, "q", path)
        command = SENT if SENT in found.signals else _only(found.signals, "dq_c", path)
        found = read_log(path, (q, command), (CLOCK,), {"q": "q"})
        values = {"q": found.values[q], "dq_c": found.values[command]}
    else:
        values = {"q": found.values["q"], "dq_c": found.values[SENT]}
    time = found.values.get(CLOCK, found.values["time"])
    columns = {"t": np.asarray(time, dtype=float).reshape(-1)}
    for stem, rows in values.items():
        columns |= {f"{stem}_{j}": np.asarray(rows[:, j - 1], dtype=float) for j in range(1, rows.shape[1] + 1)}
    folder = path if path.is_dir() else path.parent
    return next(file for file in (folder / SAMPLES, folder / SIGNALS, path) if file.is_file()), columns


def _only(signals: Sequence[str], name: str, path: Path) -> str:
    """The label of the only signal of a name."""
    labels = [label for label in signals if label.rpartition(".")[2] == name]
    if len(labels) != 1:
        what = "joint positions" if name == "q" else "velocity commands"
        raise MissingError(
            f"expected the record of a robot with {what}, one signal {name}, found {', '.join(labels) or 'none'}; "
            "use a CSV file",
            location=str(path),
        )
    return labels[0]
