"""Parts of a certificate over samples: delay lines, identities of the plant, and the command that acted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import casadi as ca

from dmframe.block.condition import SX
from dmframe.block.fields import Expressions


@final
@dataclass(frozen=True, eq=False)
class DelayLine(Expressions):
    """A sampled state that stores earlier samples: the newest first, the others pushed back, the oldest dropped.

    Parameters
    ----------
    state
        The state's name: a matrix filled with matrices of the newest's size, stacked in rows or in columns.
    newest
        The entry of this sample.
    when
        Where it is zero the state keeps its value.
    """

    state: str
    newest: SX
    when: SX = 1

    @property
    def always(self) -> bool:
        """True where it is filled at each sample."""
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
        """True for a state that holds a whole number of entries."""
        sizes = list(zip(self.newest.shape, state.shape, strict=True))
        return any(a == b for a, b in sizes) and all(a and b % a == 0 for a, b in sizes)


@final
@dataclass(frozen=True, eq=False)
class PlantIdentity(Expressions):
    r"""An identity of the plant at every instant between two samples, for all commands: :math:`\dot p + r = 0`.

    Integrated over a sample it is :math:`(p(t + T) - p(t)) / T + \langle r \rangle = 0`: the regression from which an
    estimator learns, whose rows approximate these means.

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
    """The command of the sample that is over, as rows hold it: a delay that is configured, of which the plant decides.

    Parameters
    ----------
    held
        What the rows hold as that command: a column of sampled states of the block.
    command
        What the plant applies between two samples: a column of its own signals.
    seen
        The measured position by which the block knows what the sample did.
    position
        The position itself: a column of states of the plant.
    """

    held: SX
    command: SX
    seen: SX
    position: SX
