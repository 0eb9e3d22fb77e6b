r"""Sampling intervals for which a storage function of a loop falls along the flow and at the samples.

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

For a nonlinear plant A and E vary with time in an enclosure, and (2) is required for all of them; it is convex in
(A, E), so the corners decide.

(2) is a linear matrix inequality in P and W. For a W it is solved in floating point by a Riccati equation, whose
solution exists if and only if (2) has one [Willems1971]_, and W, :math:`\beta` and :math:`\gamma` are searched. Then
(2) is decided for the numbers found by L D L' in ball arithmetic. V is of the kind of [CarnevaleTeelNesic2007]_; the
term in :math:`\beta`, which replaces their growth bound, makes it exact for one state: for
:math:`\dot x = -k x(t_k)` the intervals are those below 2 / k.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Final, final

import numpy as np
from flint import arb, arb_mat
from numpy.typing import NDArray

from dmframe.analysis.held import HeldLoop
from dmframe.exact.ball_matrix import exactly, middles, positive_definite, radii
from dmframe.exact.balls import UndecidedError, below, precise

Array = NDArray[np.float64]

LONGEST: Final = 100.0
"""Longest tested sampling interval [s]."""

_STRICT: Final = 1e-7
"""Margin in the Riccati equation, relative to its largest diagonal element."""

_FLAT: Final = 1e-14
"""Least spread of a state, relative to the largest."""

_FEW: Final = 3
_MANY: Final = 10
_CLIMBS: Final = 8000
_LONGER: Final = 1.003
"""Number of held signals above which the first W is diagonal; number of its elements above which random steps search
it, number of these steps, and factor on the interval in each that succeeds."""

_AXIS: Final = 1e-7
"""Real parts below this, relative to the largest modulus, count as zero."""

_STEPS: Final = 12
_TRIALS: Final = 60
_MOST_TRIALS: Final = 600
"""Bisection steps of one search for the interval; number of searches for each searched number, and in all."""

_ANGLES: Final = (0.05, 0.3, 0.8, 1.5)
"""First tried angles gamma T [rad]; those of one state are near zero."""

_FRACTIONS: Final = (0.9999, 0.999, 0.997, 0.99, 0.97, 0.95, 0.9, 0.8, 0.6)
"""Tested fractions of the interval found in floating point."""

_FIRST: Final = 1 / 4
"""The first tested interval, relative to the sum of the loop's time constants."""

_GAINS: Final = tuple(range(-14, 8, 2))
"""First tried logarithms of the gains of wide elements."""

_RANK: Final = 1e-9
"""Singular values below this, relative to the largest, count as zero."""

MOST_WIDE: Final = 8
"""Number of wide elements above which their corners are not enumerated."""

_THIN: Final = 1e-14
"""Radius below which an element counts as a number, relative and absolute."""

_LARGER: Final = (1.0, 1.1)
"""Tried factors on the directions: products of two uncertain numbers are not in them."""

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
    C, D = loop.grown
    PA, WC, WD = P * loop.A, W * C, W * D
    xx = PA + PA.transpose() + C.transpose() * WC
    xe = P * loop.E + C.transpose() * WD - WC.transpose() * beta
    ee = D.transpose() * WD - (WD + WD.transpose()) * beta - W * (gamma * gamma)
    top = [[*a, *b] for a, b in zip(xx.tolist(), xe.tolist(), strict=True)]
    bottom = [[*a, *b] for a, b in zip(xe.transpose().tolist(), ee.tolist(), strict=True)]
    return arb_mat([*top, *bottom])


@precise()
def corners(loop: HeldLoop) -> Iterator[HeldLoop]:
    """Loops with each wide element of A and E at one of its ends; the loop itself if there are many.

    (2) is convex in (A, E), so a storage function is proved for the enclosures if it is for these.
    """
    A, E = loop.A.tolist(), loop.E.tolist()
    places = [(M, i, j) for M in (A, E) for i, row in enumerate(M) for j in range(len(row))]
    wide = [(M, i, j) for M, i, j in places if _is_wide(M[i][j])]
    if len(wide) > MOST_WIDE:
        yield loop
        return
    for corner in product(*((M[i][j].lower(), M[i][j].upper()) for M, i, j in wide)):
        for (M, i, j), end in zip(wide, corner, strict=True):
            M[i][j] = end
        yield replace(loop, A=arb_mat(A), E=arb_mat(E))


def _is_wide(value: arb) -> bool:
    return bool(value.rad() > abs(value.mid()) * _THIN + _THIN)


def find_storage(
    loop: HeldLoop, ends: Sequence[HeldLoop] | None = None, directions: Sequence[Array] | None = None
) -> HeldStorage:
    """A storage function with a long proved interval, for all matrices in the enclosures of a loop.

    Parameters
    ----------
    ends
        Loops whose convex hull contains all matrices (A, E); by default the corners of the enclosures.
    directions
        Half the change of [A E] from one end to the other of each number that varies; by default each wide element.

    Raises
    ------
    UndecidedError
        The loop is unstable in continuous time, in the middle or at one of its ends, or nothing is proved.
    """
    ends = list(corners(loop)) if ends is None else ends
    own = list(_elements(loop)) if directions is None else directions
    for each in (loop, *ends):
        require_stable(middles(each.A), loop.states)
    proved = [_proved(loop, ends, [factor * N for N in own]) for factor in (_LARGER if own else _LARGER[:1])]
    best = max((storage for storage in proved if storage is not None), key=_interval, default=None)
    if best is None:
        raise UndecidedError("no storage function of the form that is searched falls")
    return best


def _interval(storage: HeldStorage) -> float:
    return storage.interval


def _proved(loop: HeldLoop, ends: Sequence[HeldLoop], directions: Sequence[Array]) -> HeldStorage | None:
    search = HeldSearch(loop, directions)
    best, angle, W, gains = search.best()
    for fraction in _FRACTIONS if best > 0 else ():
        found = search.storage(best * fraction, angle, W, gains=gains)
        interval = 0.0 if found is None else min(proved_interval(each, found) for each in ends)
        if found is not None and interval > 0:
            return replace(found, interval=interval)
    return None


@final
class HeldSearch:
    r"""Search in floating point, in states with a spread of one under white noise in e.

    Each direction of rank one in which [A E] varies, :math:`\delta\, b\, z^\top` with :math:`|\delta| \le 1`, is an
    input :math:`p = \delta\, z^\top (x, e)`, and a term :math:`g\, ((z^\top (x, e))^2 - p^2)` on the left side of
    (2), with a gain g > 0.
    """

    def __init__(self, loop: HeldLoop, directions: Sequence[Array] = ()) -> None:
        from scipy.linalg import block_diag, solve_continuous_lyapunov

        A, E = middles(loop.A), middles(loop.E)
        self._slow = float(np.sum(1 / -require_stable(A, loop.states)))
        spread = solve_continuous_lyapunov(A, -(E @ E.T))
        sizes, axes = np.linalg.eigh((spread + spread.T) / 2)
        self._scale = axes * np.sqrt(np.maximum(sizes, _FLAT * max(float(sizes[-1]), 1e-300)))
        self._inverse = np.linalg.inv(self._scale)
        self._A = self._inverse @ A @ self._scale
        both, pairs = block_diag(self._scale, np.eye(E.shape[1])), list[tuple[Array, Array]]()
        for N in directions:
            pairs += _of_rank_one(self._inverse @ N @ both)
        self._z = np.array([z for _, z in pairs]).reshape(-1, len(both))
        self._inputs = np.hstack([self._inverse @ E, *(b[:, None] for b, _ in pairs)])
        C, D = map(middles, loop.grown)
        self._C = C @ self._scale
        others = self._inputs[:, E.shape[1] :]
        self._D = np.hstack([D, -middles(loop.K) @ self._scale @ others]) if pairs else D
        moved = self._C @ solve_continuous_lyapunov(self._A, -np.eye(len(A))) @ self._C.T
        moved = moved + _SPREAD * max(float(np.trace(moved)) / len(moved), 1e-300) * np.eye(len(moved))
        self._first = np.linalg.cholesky(np.linalg.inv(moved))
        if len(self._first) > _FEW:
            self._first = np.diag(1 / np.sqrt(np.diag(moved)))
        self._places = np.tril_indices(len(moved))

    def best(self) -> tuple[float, float, Array, Array]:
        """The longest interval in floating point, with gamma T, W and the gains of wide elements."""
        from scipy.optimize import minimize

        shape = len(self._places[0]) if len(self._first) > 1 else 0  # the size of W does not matter
        count = len(self._z)

        def longest(z: Array) -> float:
            return self.longest(*self._numbers(z))

        gains = _GAINS if count else (0,)
        starts = [
            np.concatenate([[math.log(angle / (math.pi - angle))], np.zeros(shape), np.full(count, gain)])
            for angle in _ANGLES
            for gain in gains
        ]
        z = max(starts, key=longest)
        steps = np.diag(np.concatenate([np.full(1 + shape, 0.3), np.full(count, 1.0)]))
        options = {
            "maxfev": min(_TRIALS * len(z), _MOST_TRIALS),
            "xatol": 0.02,
            "fatol": 1e-4 * self._slow,
            "initial_simplex": np.vstack([z, z + steps]),
        }
        if shape > _MANY:
            return self._climbed(z)
        found = minimize(lambda z: -longest(z), z, method="Nelder-Mead", options=options).x
        z = max((found, z), key=longest)
        return (longest(z), *self._numbers(z))

    def _climbed(self, z: Array) -> tuple[float, float, Array, Array]:
        """The same by random steps that lengthen the interval, where W has many elements."""
        rng, step, best = np.random.default_rng(0), 0.3, self.longest(*self._numbers(z))
        if best == 0:  # no start solves it
            return (best, *self._numbers(z))
        for _ in range(_CLIMBS):
            other = z + step * rng.normal(size=len(z)) * (rng.random(len(z)) < 0.2)
            angle, W, gains = self._numbers(other)
            longer = best * _LONGER
            if self._solvable(*_multipliers(longer, angle), W, gains):
                z, best, step = other, longer, min(step * 1.5, 1.0)
            else:
                step = max(step * 0.99, 0.01)
        return (best, *self._numbers(z))

    def _numbers(self, z: Array) -> tuple[float, Array, Array]:
        """The angle gamma T, W and the gains from the searched numbers."""
        lower, count = np.eye(len(self._first)), len(self._z)
        shape = z[1 : len(z) - count]
        if len(shape):
            lower[self._places] += shape
        root = self._first @ lower
        gains = np.exp(np.clip(z[len(z) - count :], -40, 40))
        return float(np.pi / (1 + np.exp(-np.clip(z[0], -20, 20)))), root @ root.T, gains

    def longest(self, angle: float, W: Array, gains: Array | None = None) -> float:
        """The longest interval for these numbers, by bisection."""

        def fits(interval: float) -> bool:
            return self._solvable(*_multipliers(interval, angle), W, gains)

        lower, upper = 0.0, self._slow * _FIRST
        while fits(upper) and upper <= LONGEST:
            lower, upper = upper, 2 * upper
        for _ in range(_STEPS):
            middle = (lower + upper) / 2
            lower, upper = (middle, upper) if fits(middle) else (lower, middle)
        return lower

    def storage(
        self, interval: float, angle: float, W: Array, margin: float = _STRICT, gains: Array | None = None
    ) -> HeldStorage | None:
        """The storage function for these numbers, with the interval as it was sought; None without one."""
        from scipy.linalg import solve_continuous_are

        beta, gamma = _multipliers(interval, angle)
        Q, S, R = self._weights(beta, gamma, W, gains, margin)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                P = solve_continuous_are(self._A, self._inputs, Q, R, s=S)
            except (np.linalg.LinAlgError, ValueError):
                return None
        P = self._inverse.T @ ((P + P.T) / 2) @ self._inverse
        P = (P + P.T) / 2
        return HeldStorage(interval, P, (W + W.T) / 2, beta, gamma) if np.all(np.isfinite(P)) else None

    def _weights(
        self, beta: float, gamma: float, W: Array, gains: Array | None, margin: float = _STRICT
    ) -> tuple[Array, Array, Array]:
        """Q, S and R of the Riccati equation that is (2) with equality, but for a margin."""
        C, D, (e, n) = self._C, self._D, self._C.shape
        G = np.ones(len(self._z)) if gains is None else gains
        WC, WD, Z = W @ C, W @ D, self._z.T @ (G[:, None] * self._z)
        Q = C.T @ WC + Z[:n, :n]
        Q = Q + margin * max(float(np.max(np.diag(Q))), 1e-300) * np.eye(len(Q))
        S, R = C.T @ WD, D.T @ WD
        S[:, :e] += Z[:n, n:] - beta * WC.T
        R[:e] -= beta * WD
        R[:, :e] -= beta * WD.T
        R[:e, :e] += Z[n:, n:] - gamma**2 * W
        R[e:, e:] -= np.diag(G)
        return Q, S, R

    def _solvable(self, beta: float, gamma: float, W: Array, gains: Array | None) -> bool:
        """True if R < 0 and the Hamiltonian matrix has no eigenvalue on the imaginary axis."""
        Q, S, R = self._weights(beta, gamma, W, gains)
        if not np.max(np.linalg.eigvalsh(R)) < 0:
            return False
        solved = np.linalg.solve(R, np.hstack([S.T, self._inputs.T]))
        count = len(Q)
        A = self._A - self._inputs @ solved[:, :count]
        hamiltonian = np.block([[A, -self._inputs @ solved[:, count:]], [S @ solved[:, :count] - Q, -A.T]])
        found = np.linalg.eigvals(hamiltonian)
        return bool(np.min(np.abs(found.real)) > _AXIS * np.max(np.abs(found)))


def require_stable(A: Array, states: Sequence[str]) -> Array:
    """Real parts of the eigenvalues. Raises `UndecidedError` if one is not negative."""
    poles = np.linalg.eigvals(A).real
    if not np.max(poles) < 0:
        raise UndecidedError(f"in continuous time it has a pole at {np.max(poles):.3g} 1/s among {', '.join(states)}")
    return np.asarray(poles)


def _elements(loop: HeldLoop) -> Iterator[Array]:
    """Half the change of [A E] by each wide element."""
    radius = np.hstack([radii(loop.A), radii(loop.E)])
    thin = _THIN * (1 + np.abs(np.hstack([middles(loop.A), middles(loop.E)])))
    for place in zip(*np.nonzero(radius > thin), strict=True):
        found = np.zeros_like(radius)
        found[place] = radius[place]
        yield found


def _of_rank_one(N: Array) -> Iterator[tuple[Array, Array]]:
    """Columns b and rows z of the sum of b z' that is N."""
    left, sizes, right = np.linalg.svd(N)
    for k, size in enumerate(sizes):
        if size > _RANK * sizes[0]:
            yield left[:, k], size * right[k]


def _multipliers(interval: float, angle: float) -> tuple[float, float]:
    """Beta and gamma of an interval and the angle gamma T."""
    return angle / math.tan(angle) / interval, angle / interval


__all__ = ["HeldSearch", "HeldStorage", "corners", "find_storage", "proved_interval", "require_stable"]
