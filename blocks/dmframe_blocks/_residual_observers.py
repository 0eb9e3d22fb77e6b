"""Observers of a scalar signal of each joint that forecast it: a level, a level and a trend, a Fourier series.

Each holds a few numbers for each joint in one matrix, a row for a joint, and forecasts the signal some samples ahead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol, final

import casadi as ca

from dmframe.block import SX, named


class Forecasts(NamedTuple):
    """Of each expert, a column: the pose at which a command acts, the command for dq_r, and the slope dv/du."""

    q_start: SX
    command: SX
    slope: SX


class Observer(Protocol):
    """Forecast of a signal from its past values."""

    @property
    def size(self) -> int:
        """Number of states per joint."""

    def updated(self, held: SX, seen: SX, waves: Waves) -> SX:
        """The states after an update with the signal of the last sample."""

    def forecast(self, held: SX, ahead: int, waves: Waves) -> SX:
        """The signal of the `ahead`-th sample after the last one."""


@final
class Waves:
    """The columns (1, cos phi, sin phi, ..., cos H phi, sin H phi) at the phases of the samples."""

    def __init__(self, phase: SX, turn: SX) -> None:
        self._phase, self._turn = phase, turn
        self._columns = dict[tuple[int, int], SX]()

    def at(self, ahead: int, harmonics: int) -> SX:
        """The columns `ahead` samples after the last one."""
        key = ahead, harmonics
        if key not in self._columns:
            phase = self._phase + ahead * self._turn
            each = (wave(j * phase) for j in range(1, harmonics + 1) for wave in (ca.cos, ca.sin))
            self._columns[key] = named(f"h_{harmonics}_{ahead}", ca.vertcat(1, *each))
        return self._columns[key]


@final
@dataclass(frozen=True)
class Level:
    """Exponential smoothing: level + alpha (seen - level)."""

    alpha: float
    size: int = 1

    def updated(self, held: SX, seen: SX, waves: Waves) -> SX:
        """The new level."""
        return held + self.alpha * (seen - held)

    def forecast(self, held: SX, ahead: int, waves: Waves) -> SX:
        """The level."""
        return held


@final
@dataclass(frozen=True)
class Trend:
    """A level with gain alpha and its change per sample with gain beta."""

    alpha: float
    beta: float
    size: int = 2

    def updated(self, held: SX, seen: SX, waves: Waves) -> SX:
        """The new level and trend."""
        expected = held[:, 0] + held[:, 1]
        error = seen - expected
        return ca.horzcat(expected + self.alpha * error, held[:, 1] + self.beta * error)

    def forecast(self, held: SX, ahead: int, waves: Waves) -> SX:
        """The level, moved on by the trend."""
        return held[:, 0] + ahead * held[:, 1]


@final
@dataclass(frozen=True)
class Fourier:
    """The coefficients of a Fourier series, with normalised steps of a given fraction of the error."""

    harmonics: int
    share: float

    @property
    def size(self) -> int:
        """1 + 2 H."""
        return 1 + 2 * self.harmonics

    def updated(self, held: SX, seen: SX, waves: Waves) -> SX:
        """The new coefficients."""
        h = waves.at(0, self.harmonics)
        return held + self.share / (1 + self.harmonics) * (seen - held @ h) @ h.T

    def forecast(self, held: SX, ahead: int, waves: Waves) -> SX:
        """The series at that sample."""
        return held @ waves.at(ahead, self.harmonics)


SIMPLE: Final[tuple[Observer, ...]] = (
    *(Level(alpha) for alpha in (0.3, 0.15, 0.07, 0.03)),
    Trend(0.3, 0.05),
    Trend(0.2, 0.03),
    Trend(0.1, 0.01),
)
"""Observers of any signal."""

PERIODIC: Final[tuple[Observer, ...]] = (Fourier(4, 0.15), Fourier(4, 0.04), Fourier(20, 0.3), Fourier(20, 0.1))
"""Observers of a signal that repeats."""


def size_of(observers: Sequence[Observer]) -> int:
    """Number of states per joint of all observers."""
    return sum(observer.size for observer in observers)


def split(observers: Sequence[Observer], held: SX) -> list[SX]:
    """The states of each observer."""
    ends = [sum(observer.size for observer in observers[: k + 1]) for k in range(len(observers))]
    return [held[:, end - observer.size : end] for end, observer in zip(ends, observers, strict=True)]
