"""A study whose runs need no time, instead of simulations: the tests follow its rows."""

from __future__ import annotations

import hashlib
import os
import signal
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dmframe.batch.columns import joined


@dataclass(frozen=True)
class Column:
    name: str
    unit: str


@dataclass
class FakeStudy:
    """The run (point, sample) returns numbers derived from a seed of both.

    If the folder `gates` contains a pipe ``POINT-FIRST``, the worker of that chunk writes its process number to it, and
    then waits until it is killed; with a file ``poison-POINT-FIRST`` the worker kills itself; with ``fault-...``
    it raises.
    """

    points_: int = 3
    samples: int = 40
    gates: Path | None = None
    name: str = "fake"
    meaning: str = "one"
    varied: Sequence[Column] = field(default=(Column("gain", "N m"), Column("kind", "")))
    measures: Sequence[Column] = field(default=(Column("rms_final", "m"), Column("diverged", ""), Column("fault", "")))

    @property
    def points(self) -> range:
        return range(self.points_)

    @property
    def runs(self) -> int:
        return self.points_ * self.samples

    @property
    def text(self) -> str:
        return f"points: {self.points_}\nmeaning: {self.meaning}\nruns: {self.samples}\n"

    @property
    def key(self) -> str:
        return hashlib.sha256(f"{self.points_} {self.meaning}".encode()).hexdigest()

    @property
    def identity(self) -> dict[str, Any]:
        return {"points": self.points_, "meaning": self.meaning}

    @property
    def engine(self) -> str:
        return "none"

    bases: ClassVar[Mapping[str, Any]] = {}

    def cases_that(self, shape: Callable[[Any], bool]) -> list[Any]:
        return []

    def files(self) -> dict[str, bytes]:
        return {"study.yaml": self.text.encode()}

    def band(self, point: int, end: int, first: int, stop: int) -> dict[str, Any]:
        return joined([self.rows(each, first, stop) for each in range(point, end)])

    def rows(self, point: int, first: int, stop: int) -> dict[str, Any]:
        self._pass(f"{point}-{first}")
        sample = np.arange(first, stop)
        drawn = np.array([np.random.default_rng([point, i]).normal(size=2) for i in range(first, stop)])
        return {
            "run": sample * self.points_ + point,
            "point": np.full(stop - first, point),
            "sample": sample,
            "gain": drawn[:, 0],
            "kind": [f"kind_{point}"] * (stop - first),
            "rms_final": drawn[:, 1],
            "diverged": drawn[:, 1] > 2,
            "fault": ["it failed" if i % 17 == 3 else None for i in range(first, stop)],
        }

    def _pass(self, place: str) -> None:
        if self.gates is None:
            return
        if (self.gates / f"poison-{place}").exists():
            os.kill(os.getpid(), signal.SIGKILL)
        if (self.gates / f"fault-{place}").exists():
            raise ArithmeticError("no number")
        if (self.gates / place).is_fifo():
            with (self.gates / place).open("w") as pipe:  # open as long as this process lives
                pipe.write(f"{os.getpid()}\n")
                pipe.flush()
                while True:
                    signal.pause()
