r"""Symmetric linear systems with field operations only, for evaluation in exact arithmetic."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, final

import casadi as ca

from dmframe.block.naming import operation


@final
@dataclass(frozen=True)
class Inverted:
    """A symmetric matrix that is inverted, and its factors; the pivots are the divisors of `solve_spd`."""

    matrix: Any
    factor: Any
    pivots: tuple[Any, ...]


_inverted: ContextVar[tuple[list[Inverted], Sequence[Inverted]] | None] = ContextVar("inverted", default=None)


@contextmanager
def inverting(before: Sequence[Inverted] = ()) -> Iterator[list[Inverted]]:
    """Collect the matrices that are inverted in this context, which must stay positive definite.

    Factors of matrices in `before` are reused.
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
    L, *d = _called(_factored, ca.SX(A))
    return L, d


def _factored(A: Any) -> list[Any]:
    """L and the elements of d."""
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
    return [L, *d]


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
    return _called(_substituted, L, ca.vertcat(*d), ca.SX(b))[0]


def _substituted(L: Any, d: Any, b: Any) -> list[Any]:
    """Forward and back substitution."""
    rows, rest = list[Any](), b  # a single matrix changed in place would be copied at each change
    for j in range(L.shape[0]):
        rows.append(rest[0, :])
        rest = rest[1:, :] - L[j + 1 :, j] @ rows[j]
    rows = [row / pivot for row, pivot in zip(rows, ca.vertsplit(d), strict=True)]
    for i in reversed(range(L.shape[0] - 1)):
        for product in ca.vertsplit(ca.diag(L[i + 1 :, i]) @ ca.vertcat(*rows[i + 1 :])):
            if product.nnz():
                rows[i] = rows[i] - product
    return [ca.vertcat(*rows)]


def inverse_factors(A: Any) -> tuple[Any, Any]:
    r"""The unrolled factors of the inverse of a symmetric positive definite matrix, :math:`A^{-1} = M^\top N`.

    They need a third of the operations of the inverse, and replace it in products with columns.

    Parameters
    ----------
    A : SX (n, n)
        Only the lower triangle is read.

    Returns
    -------
    M : SX (n, n), unit lower triangular
    N : SX (n, n), diag(1/d) M with the pivots d of A
    """
    L, d = _factors(A)
    M, N = _called(_inverted_factors, L, ca.vertcat(*d))
    return M, N


def _inverted_factors(L: Any, d: Any) -> list[Any]:
    """M and N."""
    n = L.shape[0]
    M = ca.SX.eye(n)
    for i in range(1, n):
        M[i, :i] = -L[i, :i] @ M[:i, :i]
    return [M, ca.diag(1 / d) @ M]


def _called(stated: Callable[..., list[Any]], *given: Any) -> list[Any]:
    """Expressions of a function of matrices; its operations are created once for each sparsity pattern."""
    patterns = (tuple(item.sparsity().compress()) for item in given)
    return list(_function_of(stated, *patterns).call(list(given)))


@lru_cache(maxsize=64)
def _function_of(stated: Callable[..., list[Any]], *patterns: tuple[int, ...]) -> Any:
    """CasADi function of the operations; a call with SX arguments performs them in the same order."""
    symbols = [ca.SX.sym("given", ca.Sparsity.compressed(pattern)) for pattern in patterns]
    return ca.Function("linear", symbols, stated(*symbols))


def _factors(A: Any) -> tuple[Any, Sequence[Any]]:
    found, before = _inverted.get() or ([], ())
    known = next((item for item in before if nodes(item.matrix) == nodes(A)), None) if before else None
    L, d = ldl(A) if known is None else (known.factor, known.pivots)
    found.append(Inverted(ca.SX(A), L, tuple(d)))  # the caller may assign to elements of A
    return L, d


def nodes(A: Any) -> tuple[Any, ...]:
    """Identity of an SX expression: equal for two expressions with the same nodes."""
    return A.shape, tuple(A.sparsity().find()), tuple(item.element_hash() for item in A.nonzeros())


def square(gain: Any) -> Any:
    """A gain as a matrix; a column is the diagonal."""
    return ca.diag(gain) if gain.is_column() else gain


def inverse_spd(A: Any) -> Any:
    """Inverse of a symmetric positive definite matrix, with the same zero blocks."""
    return solve_spd(A, type(A).eye(A.shape[0]))


def metric(gain: Any) -> Any:
    """Inverse of an adaptation gain; elementwise for a column, which is a diagonal."""
    return 1 / gain if gain.is_column() else inverse_spd(gain)


def times(gain: Any, vector: Any) -> Any:
    """Product of a gain and a column; a column as gain is a diagonal."""
    return gain * vector if gain.is_column() else gain @ vector
