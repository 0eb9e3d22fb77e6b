r"""Rank monitoring: smallest singular values of matrices along a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import Signal

NEAR = 0.02
"""Ratio of smallest to largest singular value below which a matrix is near rank loss."""


@final
@dataclass(frozen=True)
class Rank:
    r"""The smallest singular value :math:`s_{min}` of a matrix along a run.

    Parameters
    ----------
    signal
        ``block.port`` of the matrix.
    unit
        Unit of the singular values.
    smallest, time
        :math:`s_{min}` where :math:`s_{min} / s_{max}` is least, and when [s].
    share
        :math:`s_{min} / s_{max}` there, between 0 and 1.
    since
        Time at which the ratio first fell below `NEAR` [s]; None if it did not.
    """

    signal: str
    unit: str
    smallest: float
    time: float
    share: float
    since: float | None

    @property
    def notice(self) -> str | None:
        """Warning of a run if the matrix is near rank loss."""
        if self.since is None:
            return None
        return (
            f"{self.signal} is near rank loss from t = {self.since:.6g} s: its smallest singular value falls to "
            f"{self.smallest:.3g} {self.unit} at t = {self.time:.6g} s, {self.share:.2g} of its largest; "
            "a reference that inverts it commands correspondingly large joint velocities"
        )


def watched(diagram: Diagram) -> list[Signal]:
    """Matrices of a diagram that require full row rank."""
    ports = {
        f"{name}.{port.name}" for name, block in diagram.blocks.items() for port in block.outputs if port.full_rank
    }
    return [signal for signal in diagram.loop.outputs if signal.label in ports]


def ranks(matrices: Sequence[Signal], columns: Mapping[str, np.ndarray], times: np.ndarray) -> tuple[Rank, ...]:
    """Smallest singular value of each matrix along a run.

    Parameters
    ----------
    columns
        By label: (N, rows columns), each row a matrix, column-major; non-finite rows are skipped.
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
        share, least = _ratios(values[good].reshape(-1, width, rows).transpose(0, 2, 1))
        k, near = int(np.argmin(share)), np.flatnonzero(share < NEAR)
        moments = times[good]
        since = float(moments[near[0]]) if near.size else None
        found.append(Rank(signal.label, signal.unit, least, float(moments[k]), float(share[k]), since))
    return tuple(found)


def _ratios(matrices: np.ndarray) -> tuple[np.ndarray, float]:
    """Ratio of smallest to largest singular value of each matrix, and the smallest one at the least ratio.

    Singular values are computed near the least ratio and near `NEAR` only; for other matrices an estimate suffices.
    """
    rows, width = matrices.shape[1:]
    if rows > width:  # never of full row rank
        return np.zeros(len(matrices)), 0.0
    guess = _guess(matrices)
    unsure = ~(
        (guess > np.nanmin(guess, initial=np.inf) + _ESTIMATE_ERROR) & (np.abs(guess - NEAR**2) > _ESTIMATE_ERROR)
    )
    exact = np.linalg.svd(matrices[unsure], compute_uv=False)
    share = np.sqrt(np.maximum(guess, 0))
    share[unsure] = np.divide(exact[:, -1], exact[:, 0], out=np.zeros(len(exact)), where=exact[:, 0] > 0)
    places = np.flatnonzero(unsure)
    return share, float(exact[np.searchsorted(places, np.argmin(share)), -1])


_ESTIMATE_ERROR = 1e-6
"""Error bound of an estimated squared ratio."""


def _guess(matrices: np.ndarray) -> np.ndarray:
    """Squared ratios from closed-form eigenvalues of a symmetric matrix, up to 3 rows; NaN for others."""
    rows = matrices.shape[1]
    size = np.max(np.abs(matrices), axis=(1, 2), initial=0.0)
    scaled = matrices / np.where(size > 0, size, 1.0)[:, None, None]
    gram = scaled @ scaled.transpose(0, 2, 1)
    if rows == 1:
        return np.ones(len(gram)) * np.where(size > 0, 1.0, np.nan)
    if rows > 3:
        return np.full(len(gram), np.nan)
    middle = np.trace(gram, axis1=1, axis2=2) / rows
    rest = gram - middle[:, None, None] * np.eye(rows)
    spread = np.sqrt(np.einsum("kij,kij->k", rest, rest) / (rows * (rows - 1)))
    with np.errstate(divide="ignore", invalid="ignore"):
        angle = np.arccos(np.clip(np.linalg.det(rest / spread[:, None, None]) / 2, -1, 1)) / 3 if rows == 3 else 0.0
        least = middle + 2 * spread * np.cos(angle + 2 * np.pi / 3) if rows == 3 else middle - spread
        most = middle + 2 * spread * np.cos(angle) if rows == 3 else middle + spread
        return np.asarray(np.where(spread > 1e-6, least / most, np.nan))
