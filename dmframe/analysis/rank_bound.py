r"""Lower bounds of the least singular value of a matrix over boxes, by interval arithmetic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dmframe.exact.enclosure import Enclosing, Enclosure, down, up

Array = NDArray[np.float64]
Shape = Literal["box", "ball"]

_AT_ONCE: Final = 1024
"""Boxes per batch; more need more memory and save no time."""

_ROUNDS: Final = 4
"""Iterations of the power method that sharpens the bound of a norm."""


@final
@dataclass(frozen=True)
class Bound:
    """Certified bound over each box of poses.

    Parameters
    ----------
    least
        (N,) below every singular value of the matrix over the box and over the set of parameters; NaN if
        undecided.
    contribution
        (N, n) contribution of each joint's width to the uncertainty.
    """

    least: Array
    contribution: Array


@final
class MatrixBound:
    r"""Bounds :math:`\sigma_{min}(J(q, a))` from below over boxes of q and a box or ball of a.

    With X near the pseudoinverse of J at the middle :math:`(q_m, a_m)`, the mean value theorem gives, entry by entry,

    .. math::

        J(q, a) X - I \in J(q_m, a_m) X - I + \sum_v [\partial_v J] X\, (v - v_m) = E,

    the derivatives enclosed over the whole box. Of E only the symmetric part :math:`E_s` counts, since
    the derivatives enclosed over the whole box. Only the symmetric part :math:`E_s` of E matters, since
    :math:`y^\top J X y \ge (1 - |E_s|) |y|^2` for every y: if :math:`|E_s| < 1`, J has full row rank, and
    .. math::

        \sigma_{min}(J) \ge (1 - |E_s|) / |X|.

    The sum over v is taken after the product with X, so that simultaneous changes of several columns of J count once. A
    pure rotation of the task, such as by a robot's first joint, contributes little: its part of E is antisymmetric.

    Parameters
    ----------
    matrix
        J, SX (m, n'), an expression in `q`, `a` and `p` only.
    values
        p; each element is a number or an enclosure.

    References
    ----------
    [Rump2010]_ for the method: an approximate inverse and an enclosed residual.
    """

    def __init__(self, matrix: Any, q: Any, a: Any, p: Any, values: Sequence[Any]) -> None:
        matrix = ca.densify(matrix)
        arguments = [q, a, p]
        slope = ca.jacobian(ca.vec(matrix), ca.vertcat(q, a))
        self.rows, self.columns = (int(size) for size in matrix.shape)
        self.n, self.h = int(q.numel()), int(a.numel())
        self.value = ca.Function("matrix", arguments, [ca.cse(ca.vec(matrix))])
        self.slope = ca.Function("slope", arguments, [ca.cse(slope)])
        self._value, self._slope = Enclosing(self.value), Enclosing(self.slope)
        self._p = list(values)

    def over(self, low: Array, high: Array, middle: Array, half: Array, shape: Shape = "box") -> Bound:
        """Bound over boxes of q, (N, n) from `low` to `high`, and the set of a about `middle` (h,).

        The set is a box of half-widths `half` (h,), or a ball: an ellipsoid with these half-axes.
        """
        parts = [
            self._over(low[k : k + _AT_ONCE].T, high[k : k + _AT_ONCE].T, middle, half, shape)
            for k in range(0, len(low), _AT_ONCE)
        ]
        return Bound(
            np.concatenate([part.least for part in parts]), np.concatenate([part.contribution for part in parts])
        )

    def _over(self, low: Array, high: Array, middle: Array, half: Array, shape: Shape) -> Bound:
        centre = np.clip((low + high) / 2, low, high)
        around = up(np.maximum(high - centre, centre - low))
        J = self._filled(self._value([list(centre), list(middle), self._p]), 1, low.shape[1])
        box = [Enclosure(*ends) for ends in zip(low, high, strict=True)]
        numbers = [Enclosure(down(a - r), up(a + r)) for a, r in zip(middle, half, strict=True)]
        slopes = self._filled(self._slope([box, numbers, self._p]), self.n + self.h, low.shape[1])
        with np.errstate(all="ignore"):  # for a singular centre the bound is NaN (undecided)
            U, s, Vt = np.linalg.svd(np.nan_to_num((J.lower + J.upper)[0].transpose(2, 0, 1) / 2), full_matrices=False)
            turned = np.swapaxes(Vt, 1, 2) / s[:, None, :]
            X = np.ascontiguousarray(np.moveaxis(turned @ np.swapaxes(U, 1, 2), 0, 2))
            U = np.ascontiguousarray(np.moveaxis(U, 0, 2))
            variation = _symmetric(times(slopes, X)).magnitude
            moved = up(around[:, None, None, :] * variation[: self.n])
            middles = _symmetric(times(J, X)) - np.eye(self.rows)[:, :, None]
            error = up(middles.magnitude[0] + _sum(moved))
            error = up(error + _spread(variation[self.n :], half, shape))
            least = down(down(1 - _norm(error)) / _size(X, U))
        # A non-finite X must not count as proved; comparisons with NaN are False, with zero they would not be.
        return Bound(np.where(np.isfinite(X).all(axis=(0, 1)), least, np.nan), np.sqrt((moved**2).sum(axis=(1, 2))).T)

    def _filled(self, found: list[list[Enclosure]], count: int, boxes: int) -> Enclosure:
        """Dense matrices from stored elements: (count, rows, columns, boxes)."""
        pattern = (self.value if count == 1 else self.slope).sparsity_out(0)
        lower, upper = (np.zeros((count, self.columns, self.rows, boxes)) for _ in range(2))
        for entry, place, variable in zip(found[0], pattern.row(), pattern.get_col(), strict=True):
            where = (variable, place // self.rows, place % self.rows)
            lower[where], upper[where] = entry.lower, entry.upper
        return Enclosure(lower.swapaxes(1, 2), upper.swapaxes(1, 2))


def times(matrices: Enclosure, X: Array) -> Enclosure:
    """Products of (v, m, n, N) and (n, k, N)."""
    total = Enclosure.of(0.0)
    for j, row in enumerate(X):
        column = Enclosure(matrices.lower[:, :, j, None], matrices.upper[:, :, j, None])
        total = Enclosure.of(row) * column + total
    return total


def _symmetric(matrices: Enclosure) -> Enclosure:
    """Half the sum of each matrix (v, m, m, N) and its transpose."""
    other = Enclosure(matrices.lower.swapaxes(1, 2), matrices.upper.swapaxes(1, 2))
    return (matrices + other) * 0.5


def _sum(parts: Array) -> Array:
    """Upper bound of a sum of nonnegative numbers over the first axis."""
    total = np.zeros(parts.shape[1:])
    for part in parts:
        total = up(total + part)
    return total


def _spread(variation: Array, half: Array, shape: Shape) -> Array:
    """Largest change of each entry of E over the set of parameters."""
    parts = up(half[:, None, None, None] * variation)
    return _sum(parts) if shape == "box" else up(np.sqrt(_sum(up(parts * parts))))


def _norm(error: Array) -> Array:
    """Upper bound of the spectral norm of each matrix whose entries are at most `error` (m, m, N).

    It is at most that of the nonnegative matrix, whose square is the largest eigenvalue of G = error' error: by Collatz
    and Wielandt at most max_i (G v)_i / v_i for any positive v, here v near the eigenvector.
    """
    G = _sum(up(error[:, :, None] * error[:, None, :]))
    v = np.ones(G.shape[1:])
    for _ in range(_ROUNDS):
        v = np.einsum("ijk,jk->ik", G, v)
        v = v / np.max(v, axis=0) + 1e-3  # positive; the bound holds for any v and is sharp near the eigenvector
    v = np.where(np.isfinite(v), v, 1.0)
    return up(np.sqrt(np.max(up(_sum(up(G.swapaxes(0, 1) * v[:, None])) / v), axis=0)))


def _size(X: Array, U: Array) -> Array:
    """Upper bound of |X| (n, m, N), with U (m, m, N) and the columns of X U nearly orthogonal.

    |X| <= |X U| / sqrt(1 - |U' U - I|), and the norm of a symmetric matrix is at most its largest row sum.
    """
    product = times(Enclosure.of(X[None]), U)
    turned = Enclosure(product.lower[0], product.upper[0])
    gram = _gram(turned).magnitude
    wrong = (_gram(Enclosure.of(U)) - np.eye(len(U))[:, :, None]).magnitude
    square = np.max(_sum(gram), axis=0)
    room = down(1 - np.max(_sum(wrong), axis=0))
    return up(np.sqrt(up(square / np.where(room > 0, room, np.nan))))


def _gram(A: Enclosure) -> Enclosure:
    """A' A."""
    total = Enclosure.of(0.0)
    for lower, upper in zip(A.lower, A.upper, strict=True):
        row = Enclosure(lower[:, None], upper[:, None])
        total = row * Enclosure(lower[None], upper[None]) + total
    return total
