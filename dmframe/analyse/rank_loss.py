"""The search for what a rank bound cannot survive: a pose and parameters at which a matrix loses rank."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from dmframe.analyse.rank_bound import MatrixBound, Shape

Array = NDArray[np.float64]

_ROUNDS: Final = 6
_MOST: Final = 400
"""Poses that the search begins from."""


@final
@dataclass(frozen=True)
class Witness:
    """Parameters at which, at a pose, a matrix is singular, or nearer to it than is asked for.

    Parameters
    ----------
    place
        Which of the poses that the search began from.
    q, a
        The pose and the parameters.
    singular
        The least singular value there; 0 where its determinant changes sign on the way from the middle.
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
    """The worst point found within the tube about the poses and the set of parameters; None where none is below `least`.

    Each round goes to the corner where the least singular value would be smallest if it were linear. Floating-point
    numbers and no completeness: it refutes a bound, it never proves one.
    """
    chosen = np.unique(np.linspace(0, len(poses) - 1, min(len(poses), _MOST)).astype(int))
    begin = np.hstack([poses[chosen], np.tile(middle, (len(chosen), 1))])
    at, value = begin, np.full(len(chosen), np.inf)
    best, sign = begin.copy(), None
    for _ in range(_ROUNDS):
        U, s, Vt = np.linalg.svd(_values(bound, at, p), full_matrices=False)
        now = s[:, -1]
        if bound.rows == bound.columns:
            turn = np.sign(np.linalg.det(U @ Vt))
            sign = turn if sign is None else sign
            now = np.where(turn == sign, now, 0.0)
        best[now < value] = at[now < value]
        value = np.minimum(now, value)
        if value.min() < least:
            break
        pull = np.einsum("ki,kvij,kj->kv", U[:, :, -1], _slopes(bound, at, p), Vt[:, -1])
        at = begin - _corner(pull, tube, half, shape)
    place = int(np.argmin(value))
    if not value[place] < least:
        return None
    q, a = np.split(best[place], [bound.n])
    return Witness(int(chosen[place]), q, a, float(value[place]))


def _corner(pull: Array, tube: float, half: Array, shape: Shape) -> Array:
    """The step to the point of the tube and of the set at which a linear function with this slope is largest."""
    n = pull.shape[1] - len(half)
    joints, numbers = tube * np.sign(pull[:, :n]), half * np.sign(pull[:, n:])
    if shape == "ball":
        scaled = pull[:, n:] * half
        numbers = half * scaled / np.maximum(np.linalg.norm(scaled, axis=1, keepdims=True), 1e-300)
    return np.hstack([joints, numbers])


def _values(bound: MatrixBound, at: Array, p: Array) -> Array:
    found = bound.value(at[:, : bound.n].T, at[:, bound.n :].T, p).full()
    return np.asarray(found.T.reshape(len(at), bound.columns, bound.rows).swapaxes(1, 2))


def _slopes(bound: MatrixBound, at: Array, p: Array) -> Array:
    """(N, variables, rows, columns)."""
    variables = bound.n + bound.h
    found = bound.slope(at[:, : bound.n].T, at[:, bound.n :].T, p).full()
    parts = found.reshape(bound.columns, bound.rows, len(at), variables)
    return np.asarray(parts.transpose(2, 3, 1, 0))
