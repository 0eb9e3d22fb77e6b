"""Columns of a log: CSV with NumPy, Parquet with polars, ROS 2 bags with rosbags, results of a drive."""

from __future__ import annotations

import csv
import io
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np

from dmframe.common.errors import MissingError, ValueFault
from dmframe.common.files import expanded
from dmframe.common.seal import digest
from dmframe.identification.drive_log import drive_columns, is_drive
from dmframe.identification.ros_log import bag_columns, bag_files, is_bag

LARGEST: Final = 2**30
"""Largest file that is read [bytes]."""
_SEPARATORS: Final = ",;\t "


@final
@dataclass(frozen=True, eq=False)
class LogTable:
    """Numbers of a log file, with the SHA-256 of its content."""

    name: str
    columns: dict[str, np.ndarray]
    digest: str


def read_table(path: str | Path, joints: Sequence[str]) -> LogTable:
    """Read a CSV or Parquet file, a ROS 2 bag, or the results of ``dmframe drive``.

    Parameters
    ----------
    joints
        Names of the robot's joints, by which those of a bag are ordered.

    Raises
    ------
    MissingError
        There is no such file, or the package that reads it is not installed.
    ValueFault
        It is empty or too large, its header has duplicates or no names, or a cell is not a number.
    """
    file = expanded(path)
    if is_drive(file):
        source, columns = drive_columns(file)
        return LogTable(str(file), columns, digest(source.read_bytes()))
    if is_bag(file):
        content = b"".join(_content(part) for part in bag_files(file) if part.is_file())
        return LogTable(str(file), bag_columns(file, joints), digest(content))
    if not file.is_file():
        raise MissingError("expected a log file, found none", location=str(file))
    content = _content(file)
    if not content.strip():
        raise ValueFault("expected a header and rows of numbers, found an empty file", location=str(file))
    columns = _parquet(file) if content[:4] == b"PAR1" else _csv(file, content)
    return LogTable(str(file), columns, digest(content))


def _content(file: Path) -> bytes:
    """Bytes of a file that is not too large."""
    try:
        if file.stat().st_size > LARGEST:
            raise ValueFault(
                f"expected at most {LARGEST >> 30} GiB, found more; cut a part of about 30 s", location=str(file)
            )
        return file.read_bytes()
    except OSError as error:
        raise MissingError(f"expected a readable log file: {error.strerror}", location=str(file)) from None


def _parquet(file: Path) -> dict[str, np.ndarray]:
    try:
        import polars
    except ImportError:
        raise MissingError("reading Parquet requires polars: pip install polars", location=str(file)) from None
    try:
        frame = polars.read_parquet(file)
        return {name: frame[name].cast(polars.Float64).to_numpy() for name in frame.columns}
    except polars.exceptions.PolarsError as error:
        raise ValueFault(f"expected a Parquet file of numbers: {error}", location=str(file)) from None


def _csv(file: Path, content: bytes) -> dict[str, np.ndarray]:
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueFault("expected text in UTF-8 or a Parquet file, found another file", location=str(file)) from None
    head = text.partition("\n")[0].strip()
    separator = max(_SEPARATORS, key=head.count)
    names = [name.strip() for name in next(csv.reader([head], delimiter=separator, skipinitialspace=True))]
    if all(_number(name) is not None for name in names):
        raise ValueFault("expected a header with names of columns, found numbers; add one", location=f"{file}:1")
    for name in names:
        if names.count(name) > 1:
            raise ValueFault(
                f"header: the column {name or '(without a name)'} appears {names.count(name)} times; rename one",
                location=f"{file}:1",
            )
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "loadtxt: input contained no data")  # the caller reports too few rows
            rows = np.loadtxt(io.StringIO(text), delimiter=None if separator == " " else separator, skiprows=1, ndmin=2)
    except ValueError:
        raise _fault(file, text, names, separator) from None
    if rows.shape[0] and rows.shape[1] != len(names):
        raise ValueFault(f"expected {len(names)} cells, as in the header, found {rows.shape[1]}", location=f"{file}:2")
    return {name: rows[:, k] if rows.size else np.empty(0) for k, name in enumerate(names)}


def _fault(file: Path, text: str, names: list[str], separator: str) -> ValueFault:
    """The first line that does not fit."""
    for number, line in enumerate(csv.reader(io.StringIO(text), delimiter=separator, skipinitialspace=True), 1):
        where = f"{file}:{number}"
        if number == 1 or not line:
            continue
        if len(line) != len(names):
            return ValueFault(f"expected {len(names)} cells, as in the header, found {len(line)}", location=where)
        for name, cell in zip(names, line, strict=True):
            if _number(cell) is None:
                comma = _number(cell.replace(",", ".", 1)) is not None
                hint = "; write a decimal point instead of the comma" if comma else ""
                return ValueFault(f"column {name}: expected a number, found {cell!r:.40}{hint}", location=where)
    return ValueFault("expected rows of numbers", location=str(file))


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None
