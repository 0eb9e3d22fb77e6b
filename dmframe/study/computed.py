"""What a worker does: the runs of one chunk, in whichever process; and what the rest may ask of a study."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol, final

import numpy as np

from dmframe.errors import visible
from dmframe.study.chunks import Chunk
from dmframe.study.plan import Study

Table = Mapping[str, Any]
"""Columns by name: arrays, or lists where there are texts."""


class Column(Protocol):
    """A column of the table."""

    @property
    def name(self) -> str:
        """As the table has it."""

    @property
    def unit(self) -> str:
        """Of its numbers."""


class Computable(Protocol):
    """What is asked of a study where it is run: it says what its runs are, and computes some of them."""

    @property
    def name(self) -> str:
        """The file's, without its ending."""

    @property
    def text(self) -> str:
        """The file."""

    @property
    def key(self) -> str:
        """A digest of all that the runs depend on, but of how many they are."""

    @property
    def identity(self) -> Mapping[str, Any]:
        """What `key` is the digest of, as plain data."""

    @property
    def engine(self) -> str:
        """What ran the last rows."""

    @property
    def points(self) -> Sequence[Any]:
        """Of the grid."""

    @property
    def samples(self) -> int:
        """Runs a point."""

    @property
    def runs(self) -> int:
        """Points times samples."""

    @property
    def varied(self) -> Sequence[Column]:
        """The columns of what varies."""

    @property
    def measures(self) -> Sequence[Column]:
        """The columns of what is measured."""

    def rows(self, point: int, first: int, stop: int) -> Table:
        """Run the samples `first` to `stop` of a point."""


@final
@dataclass(frozen=True)
class Computed:
    """The rows of a chunk, and what made them.

    Parameters
    ----------
    seconds
        Of its process that it took: how large chunks become must not hang on what else a machine does.
    made
        Processor, machine, versions: what is kept beside the rows.
    """

    table: Table
    seconds: float
    made: Mapping[str, str]


@final
@dataclass(frozen=True)
class Failed:
    """Why a chunk was not computed.

    Parameters
    ----------
    final
        Another attempt would fail, too.
    alone
        It may have failed for another chunk's sake: it is to be tried when no other is on its way.
    """

    text: str
    final: bool = False
    alone: bool = False


def compute(study: Computable, chunk: Chunk) -> Computed | Failed:
    """The rows of a chunk. Whatever a block raises is told, and ends no worker."""
    began = time.process_time()
    try:
        table = _table(study, chunk)
    except Exception as error:
        return Failed(f"{type(error).__name__}: {visible(str(error))}")
    return Computed(table, time.process_time() - began, {**machine(), "engine": study.engine})


def _table(study: Computable, chunk: Chunk) -> Table:
    if chunk.end - chunk.point == 1:
        return study.rows(chunk.point, chunk.first, chunk.stop)
    if isinstance(study, Study):  # points that differ in numbers alone run together
        return study.band(chunk.point, chunk.end, chunk.first, chunk.stop)
    return _joined([study.rows(point, chunk.first, chunk.stop) for point in range(chunk.point, chunk.end)])


def _joined(parts: Sequence[Table]) -> Table:
    return {
        name: np.concatenate([part[name] for part in parts])
        if isinstance(column, np.ndarray)
        else [value for part in parts for value in part[name]]
        for name, column in parts[0].items()
    }


@cache
def machine() -> Mapping[str, str]:
    """What last bits depend on: processor, system, versions."""
    return {"host": platform.node(), "processor": _processor(), **versions()}


@cache
def versions() -> Mapping[str, str]:
    """Of what computes: these must be the same on all workers."""
    from importlib.metadata import version

    packages = {name: version(name) for name in ("dmframe", "casadi", "numpy", "pin")}
    return {"python": ".".join(platform.python_version_tuple()[:2]), **packages}


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:  # noqa: PTH123 - read line by line
            names = (line.partition(":")[2].strip() for line in file if line.startswith("model name"))
            return next(names, "") or platform.machine()
    except OSError:  # no Linux
        return platform.processor() or platform.machine()


def cores() -> int:
    """How many processes may work at once here."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
