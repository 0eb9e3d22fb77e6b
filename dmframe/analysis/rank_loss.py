"""Search for counterexamples of a rank bound: pose and parameters at which a matrix loses rank."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from dmframe.analysis.rank_bound import MatrixBound, Shape

Array = NDArray[np.float64]

_LEAPS: Final = 6
_STEPS: Final = 14
_MOST: Final = 200
"""Number of start poses of the search."""


@final
@dataclass(frozen=True)
class Witness:
    """Pose and parameters at which a matrix is singular or violates the required bound.

    Parameters
    ----------
    place
        Index of the start pose.
    q, a
        The pose and the parameters.
    singular
        The least singular value there; 0 if its determinant changes sign between the centre and this point.
    """

    place: int
    q: Array
    a: Array
    singular: float


def witness(
    bound: MatrixBound,
    p: Array,
    poses: Array,
    tube: float,
    middle: Array,
    half: Array,
    shape: Shape,
    least: float,
) -> Witness | None:
    """Worst point found within the tube about the poses and the parameter set; None if none is below `least`.

    The first rounds linearise the least singular value and jump towards the corner where it is smallest, as far as it
    is then zero; the others descend along its gradient within the set. Floating point and incomplete: the search can
    refute a bound, never prove one.
    """
    chosen = np.unique(np.linspace(0, len(poses) - 1, min(len(poses), _MOST)).astype(int))
    begin = np.hstack([poses[chosen], np.tile(middle, (len(chosen), 1))])
    at, value = begin, np.full(len(chosen), np.inf)
    width = np.concatenate([np.full(bound.n, tube), half])
    best, sign = begin.copy(), None  # of the determinant, at the first round
    for k in range(_LEAPS + _STEPS):
        U, s, Vt = np.linalg.svd(_values(bound, at, p), full_matrices=False)
        turn = np.sign(np.linalg.det(U @ Vt)) if bound.rows == bound.columns else np.ones(len(at))
        sign = turn if sign is None else sign
        signed = s[:, -1] * turn * sign
        now = np.maximum(signed, 0.0)
        best[now < value] = at[now < value]
        value = np.minimum(now, value)
        if value.min() < least:
            break
        pull = np.einsum("ki,kvij,kj->kv", U[:, :, -1], _slopes(bound, at, p), Vt[:, -1]) * width
        if k < _LEAPS:
            corner = _corner(pull, bound.n, shape)
            falls = np.maximum(np.sum(pull * corner, axis=1), 1e-300)
            missing = signed - np.sum(pull * (at - begin) / np.where(width > 0, width, 1.0), axis=1)
            at = begin - width * corner * np.clip(missing / falls, 0.0, 1.0)[:, None]
        else:
            step = pull * (signed / np.maximum(np.sum(pull**2, axis=1), 1e-300))[:, None]
            at = begin + width * _pulled((at - begin) / np.where(width > 0, width, 1.0) - step, bound.n, shape)
    place = int(np.argmin(value))
    if not value[place] < least:
        return None
    q, a = np.split(best[place], [bound.n])
    return Witness(int(chosen[place]), q, a, float(value[place]))


def _corner(pull: Array, n: int, shape: Shape) -> Array:
    """Maximiser of a linear function with this gradient over the tube and the set, both scaled to 1."""
    joints, numbers = np.sign(pull[:, :n]), pull[:, n:]
    if shape == "box":
        return np.hstack([joints, np.sign(numbers)])
    return np.hstack([joints, numbers / np.maximum(np.linalg.norm(numbers, axis=1, keepdims=True), 1e-300)])


def _pulled(x: Array, n: int, shape: Shape) -> Array:
    """Projection onto the tube and the set, both scaled to 1."""
    joints, numbers = np.clip(x[:, :n], -1, 1), x[:, n:]
    if shape == "box":
        return np.hstack([joints, np.clip(numbers, -1, 1)])
    return np.hstack([joints, numbers / np.maximum(np.linalg.norm(numbers, axis=1, keepdims=True), 1.0)])


def _values(bound: MatrixBound, at: Array, p: Array) -> Array:
    found = bound.value(at[:, : bound.n].T, at[:, bound.n :].T, p).full()
    return np.asarray(found.T.reshape(len(at), bound.columns, bound.rows).swapaxes(1, 2))


def _slopes(bound: MatrixBound, at: Array, p: Array) -> Array:
    """Derivatives: (N, variables, rows, columns)."""
    variables = bound.n + bound.h
    found = bound.slope(at[:, : bound.n].T, at[:, bound.n :].T, p).full()
    parts = found.reshape(bound.columns, bound.rows, len(at), variables)
    return np.asarray(parts.transpose(2, 3, 1, 0))
