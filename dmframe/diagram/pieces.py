"""What a closed loop is made of: states, outputs, what is drawn, parameters."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple, final

import numpy as np

from dmframe.certificate import SX


@final
@dataclass(frozen=True)
class Variable:
    """A state of the closed loop; `shape` in letters, as declared.

    `own_rate` is its time derivative, zero of a sampled state between samples; `own_next` a sampled state's value one
    sample later, before it is projected, and None in continuous time. `own_second`, if a block states it, is what its
    step on a clock adds to T times the rate, over T^2. Only `dmframe.diagram` reads these three: every other room takes
    the flow and the map of a sample from the methods of `ClosedLoop`, so that it cannot form another map.

    Results hold a state where it is `recorded` or asked for.
    """

    block: str
    name: str
    shape: str
    unit: str
    symbol: SX
    own_rate: SX
    own_next: SX | None = None
    recorded: bool = True
    own_second: SX | None = None

    @property
    def label(self) -> str:
        """``block.state``."""
        return f"{self.block}.{self.name}"

    @property
    def sampled(self) -> bool:
        """True for a state that keeps its value between samples."""
        return self.own_next is not None

    @property
    def gained(self) -> SX | None:
        """What a sampled state moves in one sample, before it is projected; None in continuous time."""
        return None if self.own_next is None else self.own_next - self.symbol


@final
@dataclass(frozen=True)
class Signal:
    """An output of a block; `own`, of a plant's, that it stands in for no other signal."""

    block: str
    name: str
    shape: str
    unit: str
    expression: SX
    own: bool = False

    @property
    def label(self) -> str:
        """``block.port``."""
        return f"{self.block}.{self.name}"


@final
@dataclass(frozen=True)
class Noise:
    """An input that each sample draws anew, of a distribution of `dmframe.port.DISTRIBUTIONS`."""

    label: str
    symbol: SX
    distribution: str


@final
@dataclass(frozen=True)
class Parameter:
    """A gain, a true parameter or a number of the robot: `symbol` in expressions, `value` in a run.

    `exact` holds the rational numbers of which `value` is the doubles, column by column, where a file gives them.
    """

    label: str
    symbol: SX
    value: np.ndarray
    unit: str
    exact: tuple[Fraction, ...] = ()

    @property
    def rational(self) -> tuple[Fraction, ...] | None:
        """The exact numbers, as long as they are those of `value`."""
        known = self.exact and [float(number) for number in self.exact] == self.value.ravel(order="F").tolist()
        return self.exact if known else None


@final
class Followed(NamedTuple):
    """A goal s_d and the plant's output s that should follow it: their labels and expressions."""

    desired: str
    actual: str
    wanted: SX
    found: SX
