"""External inputs of each tick: time, length and random numbers."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from dmframe.common.errors import ValueFault
from dmframe.common.units import plain
from dmframe.diagram import ClosedLoop

TIME, LENGTH, DRAWN = 0, 1, 2
"""Columns of a row: t [s], the time to the next tick [s], and random numbers from there on."""

_BLOCK: Final = 1024
"""Ticks with a common random stream, so that each block can be generated independently."""


def seed_fault(value: object) -> str:
    """Error text of an invalid seed; empty for a valid one."""
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**64:
        return ""
    return f"expected a whole number from 0 to 2^64 - 1, found {value!r}"


@final
@dataclass(frozen=True)
class Instants:
    r"""Inputs of the ticks of a run, one row each, independent of engine and chunk size.

    Tick k begins at :math:`t_k = k T + \mathrm{jitter}\, u_k`, with :math:`u_k` uniform from -1 to 1 and
    :math:`t_0 = 0`, and lasts to the next.

    Parameters
    ----------
    period
        T [s].
    drawn
        Distribution of each random number: ``normal`` or ``uniform``.
    seed
        Seed of all random numbers.
    jitter
        Largest deviation of a tick from the ideal clock [s].
    """

    period: float
    drawn: tuple[str, ...] = ()
    seed: int = 0
    jitter: float = 0.0

    def __post_init__(self) -> None:
        """Check the seed, and that jitter keeps the order of ticks."""
        if text := seed_fault(self.seed):
            raise ValueFault(f"seed: {text}", path=("seed",))
        if not (math.isfinite(self.jitter) and 0 <= self.jitter < self.period / 2):
            raise ValueFault(
                f"jitter: expected a time from 0 to less than half of the period, {plain(self.period / 2, 's')}, found "
                f"{plain(self.jitter, 's')}",
                path=("jitter",),
            )

    @classmethod
    def of(cls, loop: ClosedLoop, period: float, seed: int = 0, jitter: float = 0.0) -> Instants:
        """Instants of a closed loop."""
        drawn = (noise.distribution for noise in loop.noises for _ in range(noise.symbol.numel()))
        return cls(period, tuple(drawn), seed, jitter)

    @property
    def longest(self) -> float:
        """Longest tick [s]."""
        return self.period + 2 * self.jitter

    @property
    def width(self) -> int:
        """Length of a row."""
        return DRAWN + len(self.drawn)

    def rows(self, first: int, ticks: int) -> np.ndarray:
        """(ticks, width), from the tick `first` on."""
        rows = np.empty((ticks, self.width))
        count = np.arange(first, first + ticks)
        rows[:, TIME], rows[:, LENGTH] = self.times(count), self.period
        if self.jitter:
            rows[:, LENGTH] = self.times(count + 1) - rows[:, TIME]
        if self.drawn:
            rows[:, DRAWN:] = self._random(count)[:, 1:]
        return rows

    def times(self, ticks: np.ndarray) -> np.ndarray:
        """Start times of ticks [s]."""
        times = ticks * self.period
        if not self.jitter:
            return times
        early = self._random(ticks)[:, 0]
        return np.asarray(times + np.where(ticks == 0, 0.0, self.jitter * early))

    def _random(self, ticks: np.ndarray) -> np.ndarray:
        """Random numbers of ticks: jitter, then signals."""
        found = np.empty((len(ticks), 1 + len(self.drawn)))
        blocks = ticks // _BLOCK
        for block in np.unique(blocks):
            mine = blocks == block
            found[mine] = _of_block(self.seed, int(block), self.drawn)[ticks[mine] % _BLOCK]
        return found


@functools.lru_cache(maxsize=16)
def _of_block(seed: int, block: int, drawn: tuple[str, ...]) -> np.ndarray:
    """Random numbers of a block of ticks, one row each."""
    random = np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, 0, block]))
    numbers = np.column_stack(
        [
            random.standard_normal(_BLOCK) if kind == "normal" else random.uniform(-1, 1, _BLOCK)
            for kind in ("uniform", *drawn)
        ]
    )
    numbers.flags.writeable = False
    return numbers
