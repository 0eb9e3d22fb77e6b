r"""How close a matrix that must keep its rank came to losing it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import Signal

NEAR = 0.02
"""A matrix is near rank loss where its smallest singular value is below this share of its largest."""


@final
@dataclass(frozen=True)
class Rank:
    r"""The smallest singular value :math:`s_{min}` of a matrix along a run.

    Parameters
    ----------
    signal
        ``block.port`` of the matrix.
    unit
        Of its singular values.
    smallest, time
        :math:`s_{min}` where :math:`s_{min} / s_{max}` is least, and when [s].
    share
        :math:`s_{min} / s_{max}` there, between 0 and 1.
    since
        When the share first fell below `NEAR` [s]; None where it never did.
    """

    signal: str
    unit: str
    smallest: float
    time: float
    share: float
    since: float | None

    @property
    def notice(self) -> str | None:
        """What a run says of it, where it is near rank loss."""
        if self.since is None:
            return None
        return (
            f"{self.signal} is near rank loss from t = {self.since:.6g} s: its smallest singular value falls to "
            f"{self.smallest:.3g} {self.unit} at t = {self.time:.6g} s, {self.share:.2g} of its largest; "
            "a reference that inverts it asks for joint velocities as large as that is small"
        )


def watched(diagram: Diagram) -> list[Signal]:
    """The matrices of a diagram that must keep full row rank."""
    ports = {
        f"{name}.{port.name}" for name, block in diagram.blocks.items() for port in block.outputs if port.full_rank
    }
    return [signal for signal in diagram.loop.outputs if signal.label in ports]


def ranks(matrices: Sequence[Signal], columns: Mapping[str, np.ndarray], times: np.ndarray) -> tuple[Rank, ...]:
    """What each matrix came to.

    Parameters
    ----------
    columns
        By label: (N, rows columns), each row a matrix, column by column; rows that are not finite are passed over.
    times
        (N,) [s].
    """
    found = list[Rank]()
    for signal in matrices:
        values = columns[signal.label]
        good = np.all(np.isfinite(values), axis=1)
        if not good.any():
            continue
        rows, width = signal.expression.shape
        singular = np.linalg.svd(values[good].reshape(-1, width, rows).transpose(0, 2, 1), compute_uv=False)
        # a wide matrix of rank below its rows has a zero among its first `rows` singular values; a tall one always
        least = singular[:, -1] if rows <= width else np.zeros(len(singular))
        share = np.divide(least, singular[:, 0], out=np.zeros(len(singular)), where=singular[:, 0] > 0)
        k, near = int(np.argmin(share)), np.flatnonzero(share < NEAR)
        moments = times[good]
        since = float(moments[near[0]]) if near.size else None
        found.append(Rank(signal.label, signal.unit, float(least[k]), float(moments[k]), float(share[k]), since))
    return tuple(found)
