r"""Enclosures of large matrices in floats, as midpoints and radii, valid for any order of summation.

With u = 2^-53 and sums of n products, in any order, with or without fused operations,

.. math:: |fl(A B) - A B| \le \gamma_n |A| |B| + n\, 2^{-1074}, \qquad \gamma_n = \frac{n u}{1 - n u}

[Rump2010]_ describes the method; radii are sums of nonnegative numbers, enlarged by their rounding errors.
"""

from __future__ import annotations

from typing import Final, final

import numpy as np
from flint import arb_mat
from numpy.typing import NDArray

from dmframe.exact.ball_matrix import middles, radii

Array = NDArray[np.float64]

_UNIT: Final = 2.0**-53
_LEAST: Final = 2.0**-1022


@final
class Rounded:
    """All matrices whose elements are within `radius` of `middle`."""

    __slots__ = ("middle", "radius")

    def __init__(self, middle: Array, radius: Array) -> None:
        self.middle, self.radius = middle, radius

    @staticmethod
    def of(matrix: arb_mat) -> Rounded:
        """Enclosure in floats of a high-precision ball matrix."""
        middle, radius = middles(matrix), radii(matrix)
        return Rounded(middle, (radius + np.abs(middle) * 2 * _UNIT) * (1 + 8 * _UNIT) + _LEAST)

    @staticmethod
    def exactly(middle: Array) -> Rounded:
        """Exact floats, with zero radius."""
        return Rounded(middle, np.zeros_like(middle))

    @property
    def finite(self) -> bool:
        """True if no element has overflowed."""
        return bool(np.all(np.isfinite(self.middle)) and np.all(np.isfinite(self.radius)))

    def __matmul__(self, other: Rounded) -> Rounded:
        n = self.middle.shape[1]
        lost = 2 * n * _UNIT  # exceeds gamma for every n that fits into memory
        size = np.abs(other.middle)
        spread = np.abs(self.middle) @ (other.radius + lost * size + _LEAST) + self.radius @ (size + other.radius)
        return Rounded(self.middle @ other.middle, spread * (1 + 4 * (n + 4) * _UNIT) + 4 * (n + 1) * _LEAST)

    def __sub__(self, other: Rounded) -> Rounded:
        middle = self.middle - other.middle
        spread = self.radius + other.radius + np.abs(middle) * _UNIT
        return Rounded(middle, spread * (1 + 8 * _UNIT) + _LEAST)

    @property
    def norm(self) -> float:
        """Upper bound on the largest sum of absolute values in a row."""
        n = self.middle.shape[1]
        largest = float(np.max(np.sum(np.abs(self.middle) + self.radius, axis=1), initial=0.0))
        return float(largest * (1 + 2 * (n + 2) * _UNIT))


def similar(F: Rounded, basis: Array) -> Rounded | None:
    r"""Enclosure of matrices with the same eigenvalues: of :math:`X^{-1} F X`, for an X whose invertibility is proved.

    With Y an approximate inverse and E = 1 - Y X, it is :math:`(1 - E)^{-1} Y F X`. In the maximum norm, each column is
    within |E|/(1 - |E|) of that of Y F X.
    """
    try:
        inverse = np.asarray(np.linalg.inv(basis), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    X, Y = Rounded.exactly(basis), Rounded.exactly(inverse)
    if not (X.finite and Y.finite):
        return None
    missed = (Rounded.exactly(np.eye(len(basis))) - Y @ X).norm
    if not missed < 0.5:
        return None
    moved = Y @ (F @ X)
    columns = np.max(np.abs(moved.middle) + moved.radius, axis=0)
    reach = missed / (1 - missed) * (1 + 16 * _UNIT) * columns * (1 + 4 * _UNIT)
    return Rounded(moved.middle, (moved.radius + reach[None, :]) * (1 + 4 * _UNIT) + _LEAST)


_MOST_SQUARINGS: Final = 48
_TOO_LARGE: Final = 1e60


def falls(F: Rounded) -> bool:
    """True if a power of every matrix in the enclosure is proved to have a norm below one."""
    for _ in range(_MOST_SQUARINGS):
        if not F.finite or F.norm > _TOO_LARGE:
            return False
        if F.norm < 1:
            return True
        F = F @ F
    return False


def gram(numbers: Array) -> Array:
    r"""Approximation of :math:`\sum_k (F^k)^\top F^k`, by doubling; not proved, and infinite if F is not stable."""
    P, power = np.eye(len(numbers)), numbers
    with np.errstate(all="ignore"):
        for _ in range(_MOST_SQUARINGS):
            if not np.all(np.isfinite(power)) or np.max(np.abs(power), initial=0.0) < 1e-9:
                break
            P, power = P + power.T @ P @ power, power @ power
    return (P + P.T) / 2


__all__ = ["Rounded", "falls", "gram", "similar"]
