"""Elements of a closed loop: states, outputs, random inputs, parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import NamedTuple, final

import numpy as np

from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.block.port import Side
from dmframe.common.errors import AlgebraicLoopError
from dmframe.common.slices import slices


@final
@dataclass(frozen=True)
class Variable:
    """A state of the closed loop; `shape` in letters, as declared.

    `own_rate` is its time derivative, zero for a sampled state between samples. `own_next` is the value of a sampled
    state one sample later, before projection; None for a continuous state. `own_second`, if a block states it, is the
    second-order term of its step on a clock, divided by T^2. Only `dmframe.diagram` reads these three: all other
    packages take the flow and the map of a sample from the methods of `ClosedLoop`, so that there is one map only.

    Results contain a state if it is `recorded` or requested.
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

    @cached_property
    def identities(self) -> frozenset[int]:
        """Of its scalar symbols."""
        return frozenset(symbols_in([self.symbol]))

    @property
    def label(self) -> str:
        """``block.state``."""
        return f"{self.block}.{self.name}"

    @property
    def sampled(self) -> bool:
        """True for a state that is constant between samples."""
        return self.own_next is not None

    @property
    def gained(self) -> SX | None:
        """Change of a sampled state over one sample, before projection; None for a continuous state."""
        return None if self.own_next is None else self.own_next - self.symbol


def rows_of(variables: Sequence[Variable]) -> list[tuple[Variable, slice]]:
    """Each state with its rows in a column of all of them."""
    return list(zip(variables, slices(variable.symbol.numel() for variable in variables), strict=True))


@final
@dataclass(frozen=True)
class Leaf:
    """A signal that is an independent variable of expressions: `name` is ``block.port``, `expression` its value."""

    name: str
    side: Side
    symbol: SX
    expression: SX

    @cached_property
    def identities(self) -> frozenset[int]:
        """Of its scalar symbols."""
        return frozenset(symbols_in([self.symbol]))

    def standing_for(self, expression: SX) -> Leaf:
        """The same leaf with another expression."""
        return replace(self, expression=expression)


@final
@dataclass(frozen=True)
class Signal:
    """An output of a block; `own` is true for a plant output that replaces no other signal."""

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
    """A random input, drawn at each sample from a distribution of `dmframe.block.port.DISTRIBUTIONS`."""

    label: str
    symbol: SX
    distribution: str


@final
@dataclass(frozen=True)
class Parameter:
    """A gain, a true parameter or a number of the robot: `symbol` in expressions, `value` in a run.

    `exact` contains the rational numbers that `value` rounds to doubles, column by column, if a file gives them.
    """

    label: str
    symbol: SX
    value: np.ndarray
    unit: str
    exact: tuple[Fraction, ...] = ()

    @property
    def rational(self) -> tuple[Fraction, ...] | None:
        """The exact numbers, if they still belong to `value`."""
        known = self.exact and [float(number) for number in self.exact] == self.value.ravel(order="F").tolist()
        return self.exact if known else None


@final
class Followed(NamedTuple):
    """A reference s_d and the plant output s that should track it: their labels and expressions."""

    desired: str
    actual: str
    wanted: SX
    found: SX


def loop_fault(ports: Sequence[str]) -> AlgebraicLoopError:
    """The fault of an algebraic loop through these ports."""
    remedy = "break it with a block whose output depends on its states only, such as a filter or an integrator"
    fault = AlgebraicLoopError(ports, remedy)
    fault.path = ("blocks", ports[0].partition(".")[0])
    return fault
