"""Discrete-time terms of a certificate: delay lines, plant identities, and the applied command."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import casadi as ca

from dmframe.block.condition import SX
from dmframe.block.fields import Expressions


@final
@dataclass(frozen=True, eq=False)
class DelayLine(Expressions):
    """A sampled state that stores earlier samples: the newest is inserted first, and the oldest is dropped.

    Parameters
    ----------
    state
        Name of the state: a matrix of entries of the newest one's size, stacked in rows or in columns.
    newest
        Entry of the present sample.
    when
        Condition for storing; the state is unchanged if it is zero.
    """

    state: str
    newest: SX
    when: SX = 1

    @property
    def always(self) -> bool:
        """True if an entry is stored at each sample."""
        when = ca.SX(self.when)
        return bool(when.is_scalar() and when.is_one())

    def pushed(self, state: SX) -> SX:
        """The state at the next sample."""
        rows, columns = self.newest.shape
        if columns == state.shape[1]:
            pushed = ca.vertcat(self.newest, state[: state.shape[0] - rows, :])
        else:
            pushed = ca.horzcat(self.newest, state[:, : state.shape[1] - columns])
        return pushed if self.always else ca.if_else(self.when, pushed, state)

    def fits(self, state: SX) -> bool:
        """True if the state has room for an integer number of entries."""
        sizes = list(zip(self.newest.shape, state.shape, strict=True))
        return any(a == b for a, b in sizes) and all(a and b % a == 0 for a, b in sizes)


@final
@dataclass(frozen=True, eq=False)
class PlantIdentity(Expressions):
    r"""An identity of the plant at every instant between two samples, for all commands: :math:`\dot p + r = 0`.

    Integrated over a sample it is :math:`(p(t + T) - p(t)) / T + \langle r \rangle = 0`: the regression equation of an
    estimator, whose rows approximate these means.

    Parameters
    ----------
    momentum
        p, a column.
    rest
        r, a column.
    """

    momentum: SX
    rest: SX


@final
@dataclass(frozen=True, eq=False)
class Acted(Expressions):
    """The command applied during the previous sample, as used in the rows; the plant determines the true one.

    Parameters
    ----------
    held
        Command used in the rows: a column of sampled states of the block.
    command
        Command applied by the plant between two samples: a column of its own signals.
    seen
        Measured position from which the block computes the motion during the sample.
    position
        Position: a column of states of the plant.
    """

    held: SX
    command: SX
    seen: SX
    position: SX
