r"""Sampling intervals for which a storage function of a linear loop falls along the flow and at the samples.

For the loop (1) of `dmframe.analysis.held`, let P and W be symmetric and positive definite, and :math:`\beta` and
:math:`\gamma > 0` numbers, such that for all x and e that are not both zero

.. math::

    2 x^\top P \dot x < -\dot e^\top W \dot e + 2 \beta\, e^\top W \dot e + \gamma^2 e^\top W e.         \tag{2}

Let :math:`\tau` be the time since the last sample, and :math:`\psi = \gamma \cot(\gamma \tau)`, which decreases from
infinity to :math:`\beta` at :math:`T = \operatorname{arccot}(\beta / \gamma) / \gamma`. Let

.. math:: V = x^\top P x + (\psi - \beta)\, e^\top W e.                                                  \tag{3}

Since :math:`\dot\psi = -\psi^2 - \gamma^2`, and e is zero after a sample,

.. math::

    \dot V < -(\dot e - \psi e)^\top W (\dot e - \psi e), \qquad V^+ - V = -(\psi - \beta)\, e^\top W e.  \tag{4}

Hence V falls for every sequence of sampling intervals of at most T, equal or not. After a sample :math:`e = O(\tau)`
and :math:`\psi = O(1 / \tau)`, so V has the limit :math:`x^\top P x` there. Both sides of (2) are quadratic forms, so
:math:`\dot V \le -\rho (|x|^2 + |e|^2)` with some :math:`\rho > 0`, and x goes to zero.

(2) is a linear matrix inequality in P and W. For a W it is solved in floating point by a Riccati equation, whose
solution exists if and only if (2) has one [Willems1971]_, and W, :math:`\beta` and :math:`\gamma` are searched. Then
(2) is decided for the numbers found by L D L' in ball arithmetic. V is of the kind of [CarnevaleTeelNesic2007]_; the
term in :math:`\beta`, which replaces their growth bound, makes it exact for one state: for
:math:`\dot x = -k x(t_k)` the intervals are those below 2 / k.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from flint import arb, arb_mat
from numpy.typing import NDArray

from dmframe.analysis.held import HeldLoop
from dmframe.exact.ball_matrix import exactly, middles, positive_definite
from dmframe.exact.balls import UndecidedError, below, precise

Array = NDArray[np.float64]

LONGEST: Final = 100.0
"""Longest tested sampling interval [s]."""

_STRICT: Final = 1e-5
"""Margin in the Riccati equation, relative to its largest diagonal element."""

_AXIS: Final = 1e-7
"""Real parts below this, relative to the largest modulus, count as zero."""

_STEPS: Final = 12
_TRIALS: Final = 60
_MOST_TRIALS: Final = 600
"""Bisection steps of one search for the interval; number of searches for each searched number, and in all."""

_ANGLES: Final = (0.05, 0.3, 0.8, 1.5)
"""First tried angles gamma T [rad]; those of one state are near zero."""

_FRACTIONS: Final = (0.9999, 0.999, 0.99, 0.95, 0.8)
"""Tested fractions of the interval found in floating point."""

_FIRST: Final = 1 / 4
"""The first tested interval, relative to the sum of the loop's time constants."""

_SPREAD: Final = 1e-3
"""Regularisation of the covariance whose inverse is the first W."""


@final
@dataclass(frozen=True, eq=False)
class HeldStorage:
    """A storage function (3), and the lower end of T [s]."""

    interval: float
    P: Array
    W: Array
    beta: float
    gamma: float


@precise()
def proved_interval(loop: HeldLoop, storage: HeldStorage) -> float:
    """T [s] of a storage function, rounded down; zero unless P, W > 0 and (2) are proved for all matrices enclosed."""
    P, W, beta, gamma = exactly(storage.P), exactly(storage.W), arb(storage.beta), arb(storage.gamma)
    if not (gamma > 0 and positive_definite(P) and positive_definite(W)):
        return 0.0
    if not positive_definite(-1 * _form(loop, P, W, beta, gamma)):
        return 0.0
    return max(below(((arb.pi() / 2) - (beta / gamma).atan()) / gamma), 0.0)


def _form(loop: HeldLoop, P: arb_mat, W: arb_mat, beta: arb, gamma: arb) -> arb_mat:
    """Matrix of the quadratic form in (x, e) that (2) requires to be negative."""
    C, D = loop.K * loop.A * -1, loop.K * loop.E * -1
    PA, WC, WD = P * loop.A, W * C, W * D
    xx = PA + PA.transpose() + C.transpose() * WC
    xe = P * loop.E + C.transpose() * WD - WC.transpose() * beta
    ee = D.transpose() * WD - (WD + WD.transpose()) * beta - W * (gamma * gamma)
    top = [[*a, *b] for a, b in zip(xx.tolist(), xe.tolist(), strict=True)]
    bottom = [[*a, *b] for a, b in zip(xe.transpose().tolist(), ee.tolist(), strict=True)]
    return arb_mat([*top, *bottom])


def find_storage(loop: HeldLoop) -> HeldStorage:
    """A storage function with a long proved interval.

    Raises `UndecidedError` for a loop that is unstable in continuous time, or if nothing is proved.
    """
    search = HeldSearch(loop)
    best, angle, W = search.best()
    for fraction in _FRACTIONS if best > 0 else ():
        found = search.storage(best * fraction, angle, W)
        interval = 0.0 if found is None else proved_interval(loop, found)
        if found is not None and interval > 0:
            return HeldStorage(interval, found.P, found.W, found.beta, found.gamma)
    raise UndecidedError("no storage function of the form that is searched falls")


@final
class HeldSearch:
    """Search in floating point, with states scaled by their spread under white noise in e."""

    def __init__(self, loop: HeldLoop) -> None:
        from scipy.linalg import solve_continuous_lyapunov

        A, E, K = (middles(matrix) for matrix in (loop.A, loop.E, loop.K))
        poles = np.linalg.eigvals(A)
        if not np.max(poles.real) < 0:
            raise UndecidedError(
                f"in continuous time it has a pole at {np.max(poles.real):.3g} 1/s among {', '.join(loop.states)}"
            )
        self._slow = float(np.sum(1 / -poles.real))
        spread = solve_continuous_lyapunov(A, -(E @ E.T))
        size = np.diag(spread)
        self._scale = np.sqrt(np.maximum(size, 1e-12 * max(float(np.max(size)), 1e-300)))
        self._A, self._E = A * self._scale / self._scale[:, None], E / self._scale[:, None]
        self._C, self._D = -(K * self._scale) @ self._A, -(K * self._scale) @ self._E
        moved = self._C @ (spread / np.outer(self._scale, self._scale)) @ self._C.T
        moved = moved + _SPREAD * max(float(np.trace(moved)) / len(moved), 1e-300) * np.eye(len(moved))
        self._first = np.linalg.cholesky(np.linalg.inv(moved))
        self._places = np.tril_indices(len(moved))

    def best(self) -> tuple[float, float, Array]:
        """The longest interval in floating point, with gamma T and W."""
        from scipy.optimize import minimize

        count = len(self._places[0]) if len(self._first) > 1 else 0  # the size of W does not matter

        def longest(z: Array) -> float:
            return self.longest(*self._numbers(z))

        starts = [np.append(math.log(angle / (math.pi - angle)), np.zeros(count)) for angle in _ANGLES]
        z = max(starts, key=longest)
        simplex = np.vstack([z, z + 0.3 * np.eye(len(z))])
        options = {
            "maxfev": min(_TRIALS * len(z), _MOST_TRIALS),
            "xatol": 0.02,
            "fatol": 1e-4 * self._slow,
            "initial_simplex": simplex,
        }
        found = minimize(lambda z: -longest(z), z, method="Nelder-Mead", options=options).x
        z = max((found, z), key=longest)
        return (longest(z), *self._numbers(z))

    def _numbers(self, z: Array) -> tuple[float, Array]:
        lower = np.eye(len(self._first))
        if len(z) > 1:
            lower[self._places] += z[1:]
        root = self._first @ lower
        return float(np.pi / (1 + np.exp(-np.clip(z[0], -20, 20)))), root @ root.T

    def longest(self, angle: float, W: Array) -> float:
        """The longest interval for this angle and W, by bisection."""

        def fits(interval: float) -> bool:
            return self._solvable(*_multipliers(interval, angle), W)

        lower, upper = 0.0, self._slow * _FIRST
        while fits(upper) and upper <= LONGEST:
            lower, upper = upper, 2 * upper
        for _ in range(_STEPS):
            middle = (lower + upper) / 2
            lower, upper = (middle, upper) if fits(middle) else (lower, middle)
        return lower

    def storage(self, interval: float, angle: float, W: Array, margin: float = _STRICT) -> HeldStorage | None:
        """The storage function for these numbers, with the interval as it was sought; None without one."""
        from scipy.linalg import solve_continuous_are

        beta, gamma = _multipliers(interval, angle)
        Q, S, R = self._weights(beta, gamma, W, margin)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                P = solve_continuous_are(self._A, self._E, Q, R, s=S)
            except (np.linalg.LinAlgError, ValueError):
                return None
        P = (P + P.T) / 2 / np.outer(self._scale, self._scale)
        return HeldStorage(interval, P, (W + W.T) / 2, beta, gamma) if np.all(np.isfinite(P)) else None

    def _weights(self, beta: float, gamma: float, W: Array, margin: float = _STRICT) -> tuple[Array, Array, Array]:
        """Q, S and R of the Riccati equation that is (2) with equality, but for a margin."""
        C, D = self._C, self._D
        WC, WD = W @ C, W @ D
        Q = C.T @ WC
        Q = Q + margin * max(float(np.max(np.diag(Q))), 1e-300) * np.eye(len(Q))
        return Q, C.T @ WD - beta * WC.T, D.T @ WD - beta * (WD + WD.T) - gamma**2 * W

    def _solvable(self, beta: float, gamma: float, W: Array) -> bool:
        """True if R < 0 and the Hamiltonian matrix has no eigenvalue on the imaginary axis."""
        Q, S, R = self._weights(beta, gamma, W)
        if not np.max(np.linalg.eigvalsh(R)) < 0:
            return False
        solved = np.linalg.solve(R, np.hstack([S.T, self._E.T]))
        count = len(Q)
        A = self._A - self._E @ solved[:, :count]
        hamiltonian = np.block([[A, -self._E @ solved[:, count:]], [S @ solved[:, :count] - Q, -A.T]])
        found = np.linalg.eigvals(hamiltonian)
        return bool(np.min(np.abs(found.real)) > _AXIS * np.max(np.abs(found)))


def _multipliers(interval: float, angle: float) -> tuple[float, float]:
    """Beta and gamma of an interval and the angle gamma T."""
    return angle / math.tan(angle) / interval, angle / interval


__all__ = ["HeldSearch", "HeldStorage", "find_storage", "proved_interval"]
