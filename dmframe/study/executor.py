"""Interface of executors that compute the chunks of a study, and the computation of one chunk."""

from __future__ import annotations

import platform
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol, Self, final

from dmframe.common.errors import visible
from dmframe.study.chunks import Chunk


class Computable(Protocol):
    """Object whose rows a worker computes, such as a study."""

    @property
    def engine(self) -> str:
        """Engine of the last rows in this process."""
        ...

    def band(self, point: int, end: int, first: int, stop: int) -> Mapping[str, Any]:
        """Rows of the samples [first, stop) of the points [point, end), by column."""
        ...


@final
@dataclass(frozen=True)
class Computed:
    """Rows of a chunk.

    Parameters
    ----------
    table
        Columns by name: arrays, or lists of texts.
    seconds
        CPU time of the process: the size of chunks must not depend on other load of the machine.
    made
        Processor, machine, versions and engine, for the journal.
    """

    table: Mapping[str, Any]
    seconds: float
    made: Mapping[str, str]


@final
@dataclass(frozen=True)
class Failed:
    """Failure of a chunk, with its reason.

    Parameters
    ----------
    final
        True if another attempt would fail too.
    alone
        True if another chunk may have caused the failure: this one is then repeated with no other running.
    """

    text: str
    final: bool = False
    alone: bool = False


Answer = tuple[Chunk, Computed | Failed]


class Executor(ABC):
    """Computes chunks, several at once; a context manager that ends its workers."""

    @property
    def count(self) -> int:
        """Number of chunks computed at once."""
        return 1

    @abstractmethod
    def submit(self, chunk: Chunk) -> None:
        """Queue a chunk."""

    @abstractmethod
    def ended(self, timeout: float) -> Answer | None:
        """A finished chunk; None if there is none within the timeout [s]."""

    def __enter__(self) -> Self:
        return self

    @abstractmethod
    def __exit__(self, *_: object) -> None: ...


@final
class InProcess(Executor):
    """Executor in this process, one chunk at a time, for debugging and tests."""

    def __init__(self, study: Computable) -> None:
        self._study, self._waiting = study, deque[Chunk]()

    def submit(self, chunk: Chunk) -> None:
        """Queue a chunk."""
        self._waiting.append(chunk)

    def ended(self, timeout: float) -> Answer | None:
        """Compute the first queued chunk."""
        chunk = self._waiting.popleft() if self._waiting else None
        return chunk and (chunk, compute(self._study, chunk))

    def __exit__(self, *_: object) -> None:
        self._waiting.clear()


def compute(study: Computable, chunk: Chunk) -> Computed | Failed:
    """Rows of a chunk. Any exception of a block is returned as `Failed` and does not end the worker."""
    began = time.process_time()
    try:
        table = study.band(chunk.point, chunk.end, chunk.first, chunk.stop)
    except Exception as error:
        return Failed(f"{type(error).__name__}: {visible(str(error))}")
    return Computed(table, time.process_time() - began, {**machine(), "engine": study.engine})


@cache
def machine() -> Mapping[str, str]:
    """Machine properties that affect the last bits of a result: processor, system, versions."""
    return {"host": platform.node(), "processor": _processor(), **versions()}


@cache
def versions() -> Mapping[str, str]:
    """Versions that must be equal on all workers."""
    from importlib.metadata import version

    packages = {name: version(name) for name in ("dmframe", "casadi", "numpy", "pin")}
    return {"python": ".".join(platform.python_version_tuple()[:2]), **packages}


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:  # noqa: PTH123 - read line by line
            names = (line.partition(":")[2].strip() for line in file if line.startswith("model name"))
            return next(names, "") or platform.machine()
    except OSError:  # not Linux
        return platform.processor() or platform.machine()
