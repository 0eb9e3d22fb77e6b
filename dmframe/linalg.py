r"""Symmetric linear systems in field operations only, so that exact arithmetic can follow every step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, final

import casadi as ca

from dmframe.naming import operation


@final
@dataclass(frozen=True)
class Inverted:
    """A symmetric matrix that has been inverted, and its factors; the pivots are all divisors of `solve_spd`."""

    matrix: Any
    factor: Any
    pivots: tuple[Any, ...]


_inverted: ContextVar[tuple[list[Inverted], Sequence[Inverted]] | None] = ContextVar("inverted", default=None)


@contextmanager
def inverting(before: Sequence[Inverted] = ()) -> Iterator[list[Inverted]]:
    """Collect the matrices that are inverted meanwhile: each has to stay positive definite.

    The factors of one that is the same as one of `before` are not computed again.
    """
    found = list[Inverted]()
    token = _inverted.set((found, before))
    try:
        yield found
    finally:
        _inverted.reset(token)


def ldl(A: Any) -> tuple[Any, list[Any]]:
    r"""The unrolled factors of a symmetric positive definite matrix, :math:`A = L \,\mathrm{diag}(d)\, L^\top`.

    Parameters
    ----------
    A : SX (n, n)
        Only the lower triangle is read.

    Returns
    -------
    L : SX (n, n), unit lower triangular
    d : list of n SX scalars
    """
    n = A.shape[0]
    L, weighed = ca.SX.eye(n), ca.SX(n, n)  # weighed = L diag(d)
    d: list[Any] = []
    for j in range(n):
        # column = L[:, j] d[j], kept before the division: n reciprocals for the whole factorisation.
        column = ca.SX(A[j:, j]) - weighed[j:, :j] @ L[j, :j].T
        d.append(column[0])
        if j + 1 < n:
            L[j + 1 :, j] = column[1:] / d[j]
            weighed[j + 1 :, j] = L[j + 1 :, j] * d[j]
    return L, d


@operation
def solve_spd(A: Any, b: Any) -> Any:
    r"""Solve :math:`A x = b` for a symmetric positive definite A, by :math:`L D L^\top` without a square root.

    Parameters
    ----------
    A : SX (n, n)
        Only the lower triangle is read.
    b : SX (n, columns)
    """
    L, d = _factors(A)
    n = A.shape[0]
    x = ca.SX(b)
    for i in range(n):
        for j in range(i):
            x[i, :] -= L[i, j] * x[j, :]
    for i in range(n):
        x[i, :] /= d[i]
    for i in reversed(range(n)):
        for j in range(i + 1, n):
            x[i, :] -= L[j, i] * x[j, :]
    return x


def _factors(A: Any) -> tuple[Any, Sequence[Any]]:
    found, before = _inverted.get() or ([], ())
    known = next((item for item in before if nodes(item.matrix) == nodes(A)), None) if before else None
    L, d = ldl(A) if known is None else (known.factor, known.pivots)
    found.append(Inverted(A, L, tuple(d)))
    return L, d


def nodes(A: Any) -> tuple[Any, ...]:
    """What an SX is made of: equal for two that are the same expression, node by node."""
    return A.shape, tuple(A.sparsity().find()), tuple(item.element_hash() for item in A.nonzeros())


def square(gain: Any) -> Any:
    """A gain as a matrix; a column stands for its diagonal."""
    return ca.diag(gain) if gain.is_column() else gain


def inverse_spd(A: Any) -> Any:
    """The inverse of a symmetric positive definite matrix, zero where its blocks are."""
    return solve_spd(A, type(A).eye(A.shape[0]))


def metric(gain: Any) -> Any:
    """The inverse of an adaptation gain: elementwise of a column, which stands for a diagonal."""
    return 1 / gain if gain.is_column() else inverse_spd(gain)


def times(gain: Any, vector: Any) -> Any:
    """A gain times a column; a column for the gain stands for a diagonal."""
    return gain * vector if gain.is_column() else gain @ vector
