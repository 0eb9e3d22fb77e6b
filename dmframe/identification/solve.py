"""Output error: Gauss-Newton on the positions of simulated twins, damped, with sensitivities by differences."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from dmframe.identification.log import Log
from dmframe.identification.model import Array
from dmframe.identification.twin import LONGEST, Twins, schedule
from dmframe.identification.unknowns import Unknowns

STEP: Final = 1e-5
"""Difference of an unknown for its sensitivity."""
DAMPINGS: Final = 10.0 ** np.arange(-5, 3)
"""Damping factors that are tried at once: as many as a register has elements."""
ROUNDS: Final = 25
MOST_DELAY: Final = 8.0
"""Longest delay that is fitted [samples]."""
CONVERGED: Final = 0.02
"""Decrease of the cost, twice a log likelihood, below which a fit has converged."""

EXACT: Final = 0.03
"""Error of the integrator, relative to the floor, that does not count."""
FINEST: Final = 2.5e-4
"""Shortest step of the integrator [s]."""
POSES: Final = 60
"""Positions of the log at which the mass matrix has to be positive definite."""
RESOLUTION: Final = 1e-7
"""Deviation of a position that no twin explains [rad]."""
FAR: Final = 3.0
"""Inflation above which a candidate does not explain the log yet."""
SLOW: Final = 0.005
"""Relative decrease of the cost below which such a candidate is given up."""


@final
@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted candidate.

    Parameters
    ----------
    theta, covariance
        Unknowns, and their covariance with the residual's autocorrelation.
    residual
        (samples, n), recorded minus simulated positions [rad].
    inflation
        Of each joint, sqrt(1 + 2 sum of the residual's autocorrelations).
    """

    unknowns: Unknowns
    theta: Array
    covariance: Array
    residual: Array
    inflation: Array

    @property
    def rms(self) -> Array:
        """RMS residual of each joint [rad]."""
        return np.asarray(np.sqrt(np.mean(self.residual**2, axis=0)))


def inflation_of(residual: Array) -> Array:
    """Factor by which autocorrelation of each column's residual widens standard deviations, at least 1."""
    count, found = len(residual), []
    for column in residual.T:
        power = np.abs(np.fft.rfft(column, 2 * count)) ** 2
        rho = np.fft.irfft(power)[: count // 4]
        rho = rho / max(rho[0], 1e-300)
        pairs = rho[1:-1:2] + rho[2::2]  # Geyer: sum while pairs are positive
        last = int(np.argmax(pairs <= 0)) if np.any(pairs <= 0) else len(pairs)
        found.append(np.sqrt(max(1.0, 1 + 2 * float(np.sum(pairs[:last])))))
    return np.array(found)


def solved(twins: Twins, unknowns: Unknowns, start: Array, rounds: int = ROUNDS, step: float = LONGEST) -> Fit:
    """Minimise the weighted squares of recorded minus simulated positions, and of deviations from the prior.

    `step` is the longest step of the integrator [s].
    """
    log, theta, damping = unknowns.log, start.copy(), 1e-2
    mean, deviation = unknowns.prior
    precision = np.where(np.isinf(deviation), 0.0, 1 / deviation**2)
    place = unknowns.places["delay"].start
    fit, some = None, log.q[:: max(1, len(log.q) // POSES)]
    for _ in range(rounds):
        delay = float(theta[place]) * log.period
        plan = schedule(log, delay, step)
        columns = np.hstack([theta[:, None], theta[:, None] + STEP * np.eye(len(theta))])
        q = twins.positions(plan, unknowns.numbers(columns, delay))
        residual = difference(log, q[:, :, 0])
        if not np.all(np.isfinite(q)):
            break
        J = (q[:, :, 1:] - q[:, :, :1]) / STEP
        if log.hidden is not None:
            J[log.hidden] = 0
        inflation = inflation_of(residual)
        weight = 1 / (np.sqrt(np.mean(residual**2, axis=0) + RESOLUTION**2) * inflation)
        scaled = (J * weight[None, :, None]).reshape(-1, len(theta))
        H = scaled.T @ scaled + np.diag(precision)
        g = scaled.T @ (residual * weight).ravel() - precision * (theta - mean)
        size = np.sqrt(np.maximum(np.diag(H), 1e-12))
        normal = H / np.outer(size, size)
        fit = Fit(unknowns, theta, _inverse(normal) / np.outer(size, size), residual, inflation)
        factors = DAMPINGS * damping
        tried = []
        for factor in factors:
            change = np.linalg.solve(normal + (factor + 1e-12) * np.eye(len(theta)), g / size) / size
            change *= min(1.0, 2.0 / max(np.max(np.abs(change[: unknowns.places["B"].start])), 1e-12))
            tried.append(theta + np.clip(change, -3, 3))
        trial = np.array(tried).T
        trial[place] = np.clip(trial[place], max(0.0, theta[place] - 0.6), min(theta[place] + 0.6, MOST_DELAY))
        numbers = unknowns.numbers(trial, delay)
        there = twins.positions(plan, numbers)
        costs = np.array([_cost(difference(log, there[:, :, k]), weight) for k in range(trial.shape[1])])
        costs += np.sum(precision[:, None] * (trial - mean[:, None]) ** 2, axis=0)
        now = _cost(residual, weight) + float(np.sum(precision * (theta - mean) ** 2))
        costs[~unknowns.model.physical(some, numbers)] = np.inf  # the implicit integrator would damp them
        best = int(np.nanargmin(np.where(np.isfinite(costs), costs, np.inf)))
        if not costs[best] < now:
            if damping > 1e3:
                break
            damping *= 1e3
            continue
        theta, damping = trial[:, best], float(np.clip(factors[best], 1e-3, 1e3))
        far = float(np.max(inflation)) > FAR and now - costs[best] < SLOW * now
        if now - costs[best] < CONVERGED or far:
            break
    if fit is None:
        empty = np.full_like(log.q, np.inf)
        return Fit(unknowns, theta, np.eye(len(theta)), empty, np.ones(unknowns.model.n))
    return fit


def difference(log: Log, q: Array) -> Array:
    """Recorded minus simulated positions; zero for samples that are not compared."""
    found = log.q - q
    return found if log.hidden is None else np.where(log.hidden[:, None], 0.0, found)


def total(twins: Twins, unknowns: Unknowns, theta: Array) -> float:
    """Sum of the joints' logarithms of the residual; infinite after a divergence."""
    log, delay = unknowns.log, float(theta[unknowns.places["delay"].start]) * unknowns.log.period
    q = twins.positions(schedule(log, delay), unknowns.numbers(theta[:, None], delay))
    found = float(np.sum(np.log(np.sqrt(np.mean(difference(log, q[:, :, 0]) ** 2, axis=0)))))
    return found if np.isfinite(found) else np.inf


def fine_step(twins: Twins, fit: Fit, floor: Array) -> float:
    """Step of the integrator whose error is a small fraction of the floor, by halving it [s]."""
    unknowns, step = fit.unknowns, LONGEST
    delay = float(fit.theta[unknowns.places["delay"].start]) * unknowns.log.period
    numbers = unknowns.numbers(fit.theta[:, None], delay)
    before = twins.positions(schedule(unknowns.log, delay, step), numbers)
    while step > FINEST and np.all(np.isfinite(before)):
        after = twins.positions(schedule(unknowns.log, delay, step / 2), numbers)
        if np.all(np.sqrt(np.mean((after - before) ** 2, axis=0))[:, 0] < EXACT * floor):
            break
        step, before = step / 2, after
    return step


def _inverse(A: Array) -> Array:
    """Inverse of a positive semidefinite matrix; directions below the rounding error get a large variance, not none."""
    values, vectors = np.linalg.eigh(A)
    return np.asarray((vectors / np.maximum(values, 1e-14 * values[-1])) @ vectors.T)


def _cost(residual: Array, weight: Array) -> float:
    return float(np.sum((residual * weight) ** 2))
