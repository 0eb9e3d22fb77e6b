r"""Largest values of linear functions over a polytope, with verified duals.

For the polytope :math:`\{z : A z \le b,\ |z_i| \le r_i\}` and any :math:`\lambda \ge 0`,

.. math:: p^\top z \le \lambda^\top b + |p - A^\top \lambda|^\top r                                      \tag{1}

Linear programming finds the :math:`\lambda` with the least right-hand side; the returned value is (1) evaluated at it,
so that its validity does not depend on the solver. Consecutive functions of a path differ little: the search moves
along edges of the polytope from the vertex of the previous function, usually by a few pivots. Where it does not end,
HiGHS solves the program.
"""

from __future__ import annotations

from typing import Final, final

import numpy as np

from dmframe.bounds.disturbed import NoBoundError

PIVOTS: Final = 400
"""Largest number of edges on the way to an optimum; more indicate a degenerate vertex."""
TIGHT: Final = 1e-9
"""Slack, relative to the size of the polytope, up to which an inequality counts as tight."""
ROUNDING: Final = 1e-9
"""Relative addition for the rounding of (1) in floating point, whose error is some 1e-14 of the absolute sum."""


@final
class Polytope:
    """The polytope of the module docstring, bounded by the box of half-widths r about zero.

    Parameters
    ----------
    A, b
        (N, n) and (N,).
    lower, upper
        (n,) lower and upper ends of the box.

    Raises
    ------
    NoBoundError
        It is empty.
    """

    def __init__(self, A: np.ndarray, b: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> None:
        n = A.shape[1]
        size = np.linalg.norm(A, axis=1)
        used = size > 0
        if np.any(b[~used] < 0):
            raise NoBoundError("the set of parameters that the samples admit is empty")
        self._A = np.vstack([A[used] / size[used, None], np.eye(n), -np.eye(n)])
        self._b = np.concatenate([b[used] / size[used], upper, -lower])
        self._radius = np.maximum(np.abs(lower), np.abs(upper))
        width = float(np.median(np.abs(self._b[: -2 * n]))) if used.any() else 0.0
        self._scale = 1 / width if width > 0 else 1.0  # the tolerances of HiGHS are absolute
        self.pivots = 0
        self._basis = self._vertex(np.ones(n))

    def top(self, p: np.ndarray) -> float:
        """An upper end of p'z over the polytope: the largest value up to rounding."""
        scale = float(np.max(np.abs(p), initial=0.0))
        if scale == 0:
            return 0.0
        p = p / scale
        multipliers = self._walked(p)
        if multipliers is None:
            multipliers = self._solved(p)[1]
        return scale * self._bound(p, multipliers)

    def _bound(self, p: np.ndarray, multipliers: np.ndarray) -> float:
        """The right-hand side of (1), with an addition for its rounding."""
        left = p - multipliers @ self._A
        value = multipliers @ self._b + np.abs(left) @ self._radius
        return float(value + ROUNDING * (multipliers @ np.abs(self._b) + np.abs(p) @ self._radius))

    def _walked(self, p: np.ndarray) -> np.ndarray | None:
        """Multipliers by the simplex method from the current vertex; None if it does not end."""
        A, b, basis = self._A, self._b, self._basis
        for _ in range(PIVOTS):
            try:
                inverse = np.linalg.inv(A[basis])
            except np.linalg.LinAlgError:
                break
            multipliers = p @ inverse
            leaving = int(np.argmin(multipliers))
            if multipliers[leaving] >= -TIGHT:
                found = np.zeros(len(b))
                found[basis] = np.maximum(multipliers, 0.0)
                return found
            along = -inverse[:, leaving]
            slope, slack = A @ along, np.maximum(b - A @ (inverse @ b[basis]), 0.0)
            slope[basis] = 0.0
            far = np.full(len(b), np.inf)
            rising = slope > TIGHT
            far[rising] = slack[rising] / slope[rising]
            entering = int(np.argmin(far))
            if not np.isfinite(far[entering]):
                break
            basis[leaving] = entering
            self.pivots += 1
        self._basis = self._vertex(p)
        return None

    def _vertex(self, p: np.ndarray) -> np.ndarray:
        """Independent tight inequalities at an optimum."""
        point, _ = self._solved(p)
        order = np.argsort(self._b - self._A @ point)
        basis, directions = list[int](), np.zeros((0, len(p)))
        for row in order:
            rest = self._A[row] - directions.T @ (directions @ self._A[row])
            size = np.linalg.norm(rest)
            if size > 1e-6:
                basis.append(int(row))
                directions = np.vstack([directions, rest / size])
            if len(basis) == len(p):
                break
        return np.array(basis)

    def _solved(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Optimum and multipliers by HiGHS."""
        from scipy.optimize import linprog  # its import takes a quarter of a second

        rows, ends = self._scale * self._A, self._scale * self._b
        found = linprog(-p, A_ub=rows, b_ub=ends, bounds=(None, None), method="highs-ds")
        if found.status == 2:
            raise NoBoundError("the set of parameters that the samples admit is empty")
        if found.status:
            raise NoBoundError(f"the linear program over the parameters was not solved: {found.message}")
        return np.asarray(found.x), self._scale * np.maximum(-np.asarray(found.ineqlin.marginals), 0.0)


def least_residual(A: np.ndarray, b: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> float:
    r"""The least :math:`\max_i |b_i - A_i z|` over the box: no smaller :math:`\bar\eta` admits any parameters."""
    from scipy.optimize import linprog

    size = max(float(np.max(np.abs(b))), np.finfo(float).tiny)
    ones = np.ones((len(b), 1))
    rows = np.vstack([np.hstack([A, -size * ones]), np.hstack([-A, -size * ones])]) / size
    goals = np.concatenate([b, -b]) / size
    bounds = [*zip(lower, upper, strict=True), (0, None)]
    cost = np.concatenate([np.zeros(A.shape[1]), [1.0]])
    found = linprog(cost, A_ub=rows, b_ub=goals, bounds=bounds, method="highs-ds")
    if found.status:
        raise NoBoundError(f"the linear program over the parameters was not solved: {found.message}")
    return float(size * found.x[-1])
