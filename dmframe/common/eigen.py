"""Eigenvalues of a small symmetric matrix, unrolled into a fixed number of operations, the same on every engine."""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca

SWEEPS = 5
"""Number of sweeps over the off-diagonal elements; for 4 x 4 matrices, five sweeps converge to rounding."""
TINY = 2.0**-200
"""Regularisation under the root, so that equal eigenvalues give finite values and derivatives."""


def eigen(A: Any) -> tuple[Any, Any]:
    r"""Eigenvalues and eigenvectors by Jacobi's rotations, :math:`A = V \,\mathrm{diag}(d)\, V^\top`.

    Parameters
    ----------
    A : SX (n, n)
        Symmetric; only the lower triangle is read. n is 4 at most, for which the sweeps suffice.

    Returns
    -------
    d : SX (n,)
        In no order.
    V : SX (n, n)
        Orthonormal.

    References
    ----------
    [GolubVanLoan2013]_ section 8.5.
    """
    values, vectors = _unrolled(A.shape[0])(A)
    return values, vectors


@cache
def _unrolled(n: int) -> Any:
    """Rotations for n rows, cached: building them takes longer than substituting symbols."""
    A = ca.SX.sym("A", n, n)
    a = [[A[max(i, j), min(i, j)] for j in range(n)] for i in range(n)]
    v = [[ca.SX(float(i == j)) for j in range(n)] for i in range(n)]
    for _ in range(SWEEPS):
        for p in range(n):
            for q in range(p + 1, n):
                _rotate(a, v, p, q)
    return ca.Function("eigen", [A], [ca.vertcat(*(a[i][i] for i in range(n))), ca.blockcat(v)])


def positive_part(A: Any) -> Any:
    """The nearest positive semidefinite matrix, in the Frobenius norm: A with its negative eigenvalues at zero."""
    d, V = eigen(A)
    return V @ ca.diag(ca.fmax(d, 0)) @ V.T


def _rotate(a: list[list[Any]], v: list[list[Any]], p: int, q: int) -> None:
    """Jacobi rotation of rows and columns p and q, by at most 45 degrees, that makes element (p, q) zero."""
    across, difference = a[p][q], a[q][q] - a[p][p]
    sign = ca.if_else(difference < 0, -1, 1)
    tangent = 2 * across * sign / (ca.fabs(difference) + ca.sqrt(difference * difference + 4 * across * across + TINY))
    cosine = 1 / ca.sqrt(1 + tangent * tangent)
    sine = tangent * cosine
    a[p][p], a[q][q] = a[p][p] - tangent * across, a[q][q] + tangent * across
    a[p][q] = a[q][p] = ca.SX(0)
    for r in range(len(a)):
        if r not in (p, q):
            a[r][p], a[r][q] = cosine * a[r][p] - sine * a[r][q], sine * a[r][p] + cosine * a[r][q]
            a[p][r], a[q][r] = a[r][p], a[r][q]
    for row in v:
        row[p], row[q] = cosine * row[p] - sine * row[q], sine * row[p] + cosine * row[q]


__all__ = ["SWEEPS", "eigen", "positive_part"]
