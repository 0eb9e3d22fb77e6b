"""Choice of the servo's class: every candidate is fitted, and compared at one noise model."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final, final

import numpy as np

from dmframe.identification.log import Log
from dmframe.identification.model import Array
from dmframe.identification.roots import with_friction
from dmframe.identification.rows import rows_of, starts
from dmframe.identification.solve import MOST_DELAY, RESOLUTION, ROUNDS, Fit, fine_step, solved, total
from dmframe.identification.twin import Twins
from dmframe.identification.unknowns import SERVOS, Unknowns

STARTS: Final = 3
"""Delays from which a candidate is fitted, as long as its residual is above the floor."""
NEAR: Final = 0.01
"""Deviation of f from 1 that does not count."""
ABOUT: Final = 0.1
"""Deviation of f from 1 up to which a PID servo is fitted from the cascade."""
BRIEF: Final = 8
"""Rounds of a candidate after another one has explained the log."""
ABOVE: Final = 3.0
"""Largest residual of an explained log, in floors."""
SHARP: Final = 1.25
"""Largest residual of a fit that leaves noise only, in standard deviations of the noise."""
SMALL: Final = 0.2
"""Part of the tracking error's share in the floor that counts as noise."""
WHITE: Final = 2.5
"""Largest inflation of such a residual."""
SAME: Final = 1e-3
"""Increase of the sum of the joints' logarithms of residuals between two fits of the same motion."""
SHARE: Final = 0.001
"""Fraction of the tracking error that counts as explained."""


@final
@dataclass(frozen=True, eq=False)
class Choice:
    """Fitted candidates.

    Parameters
    ----------
    fits
        The best fit of each candidate, by its key in `SERVOS`.
    floor
        (n,), residual of a twin that is exact: noise, and a thousandth of the tracking error [rad].
    noise
        Standard deviation of the positions' noise [rad].
    """

    fits: dict[str, Fit]
    floor: Array
    noise: float = np.inf

    @property
    def best(self) -> str:
        """The candidate with the smallest information criterion; a cascade whose f may be 1 is a PID servo."""
        closest = min(self.fits.values(), key=lambda fit: float(np.sum(np.log(fit.rms))))
        best = min(self.fits, key=lambda kind: criterion(self.fits[kind], closest.inflation))
        return "pid" if best == "p_pi" and self.explained("pid") and self._full_feed_forward else best

    @property
    def _full_feed_forward(self) -> bool:
        fit = self.fits["p_pi"]
        place = fit.unknowns.places["f"]
        spread = 3 * np.sqrt(np.diag(fit.covariance)[place])  # with several joints, one may exceed 2 by chance
        return bool(np.all(np.abs(fit.theta[place] - 1) <= np.maximum(spread, NEAR)))

    def explained(self, kind: str) -> bool:
        """True if the residual of a candidate is near the floor on every joint."""
        return bool(np.all(self.fits[kind].rms <= ABOVE * self.floor))

    @property
    def left(self) -> float:
        """Sum of the joints' logarithms of the best candidate's residual."""
        return float(np.sum(np.log(self.fits[self.best].rms)))

    def sharp(self, kind: str) -> bool:
        """True if a candidate leaves noise only, so that its fit is no local minimum."""
        fit = self.fits[kind]
        return bool(np.all(fit.rms <= SHARP * self.least) and np.all(fit.inflation <= WHITE))

    @property
    def least(self) -> Array:
        """Residual below which a fit leaves noise only: of the noise, and a small fraction of the tracking error."""
        if not np.isfinite(self.noise):
            return np.full_like(self.floor, np.inf)
        error = np.sqrt(np.maximum(self.floor**2 - self.noise**2, 0.0))
        return np.asarray(np.hypot(self.noise, SMALL * error) + RESOLUTION)


def criterion(fit: Fit, inflation: Array) -> float:
    """Bayesian information criterion of a fit, with the effective number of samples of the closest fit."""
    effective = len(fit.residual) / inflation**2
    places = fit.unknowns.places  # candidates differ in the servo's parameters and in the friction per torque only
    free = places["B"].start + (fit.unknowns.model.n if "L" in places else 0)
    return float(np.sum(2 * effective * np.log(fit.rms)) + free * np.log(max(float(np.sum(effective)), 2.0)))


def floor_of(log: Log) -> Array:
    """Residual of a twin that is exact, of each joint [rad]."""
    error = log.q - log.q[0] - log.commanded(log.time)
    return np.asarray(np.hypot(log.noise, SHARE * np.std(error, axis=0)) + 1e-7)


@final
@dataclass(frozen=True, eq=False)
class Candidates:
    """The classes of servos, fitted to a log.

    Parameters
    ----------
    choice
        The best fit of each so far, which `fit`, `refine` and `again` improve.
    by_torque
        Whether friction grows with the torque.
    """

    twins: Twins
    log: Log
    choice: Choice
    by_torque: bool

    @cached_property
    def unknowns(self) -> dict[str, Unknowns]:
        """Unknowns of each candidate."""
        return {kind: Unknowns(self.twins.model, self.log, kind, self.by_torque) for kind in SERVOS}

    @property
    def explained(self) -> bool:
        """True if a candidate's residual is near the floor."""
        return any(map(self.choice.explained, self.choice.fits))

    @property
    def sharp(self) -> bool:
        """True if the best candidate leaves noise only."""
        return self.choice.sharp(self.choice.best)

    def fit(self, started: Mapping[str, Array]) -> None:
        """Fit candidates, each from a start, or from the candidate that explains the log if that is nearer."""
        for kind, start in started.items():
            own, found = self.unknowns[kind], self.choice
            known = [fit for other, fit in found.fits.items() if found.explained(other)]
            if known:
                closest = min(known, key=lambda fit: float(np.sum(np.log(fit.rms))))
                others = [start, own.carried(closest.unknowns, closest.theta)]
                start = min(others, key=lambda theta: total(self.twins, own, theta))
            self._keep(solved(self.twins, own, start, BRIEF if known else ROUNDS))

    def fit_from(self, other: Candidates) -> None:
        """Fit candidates from the fits of others, those first that are nearest."""
        near = sorted(other.choice.fits.items(), key=lambda item: float(np.sum(np.log(item[1].rms))))
        self.fit({kind: self.unknowns[kind].carried(fit.unknowns, fit.theta) for kind, fit in near})

    def refine(self) -> None:
        """Fit the best candidate further, if it explains the log: rounds may have been few, the integrator coarse.

        A cascade whose feed-forward is complete is a PID servo: both have to converge before they are compared.
        """
        found, pid = self.choice, self.unknowns["pid"]
        best = found.fits[found.best]
        if best.unknowns.kind == "p_pi" and np.all(np.abs(best.theta[best.unknowns.places["f"]] - 1) < ABOUT):
            self._keep(solved(self.twins, pid, pid.carried(best.unknowns, best.theta)))
            best = found.fits[found.best]
        if found.explained(found.best):
            step = fine_step(self.twins, best, found.floor)
            found.fits[found.best] = solved(self.twins, best.unknowns, best.theta, step=step)

    def settle(self) -> None:
        """Of two cascades with the same motion take the other one if the viscous friction is clearly negative."""
        fit = self.choice.fits[self.choice.best]
        if fit.unknowns.kind != "p_pi" or not self.explained:
            return
        deviation = np.sqrt(np.diag(fit.covariance)[fit.unknowns.places["B"]])
        start = with_friction(fit.unknowns, fit.theta, deviation)
        if np.any(start != fit.theta):
            other = solved(self.twins, fit.unknowns, start, step=fine_step(self.twins, fit, self.choice.floor))
            if np.sum(np.log(other.rms / fit.rms)) < SAME:
                self.choice.fits["p_pi"] = other

    def again(self) -> None:
        """Fit from more starts until a fit leaves noise only: other delays, of all candidates that explain the log."""
        found = self.choice
        near = found.fits[found.best]
        own = [self.unknowns[kind] for kind in self.unknowns if found.explained(kind) or kind == found.best]
        for candidate in own:
            for theta in _shifted(candidate, near):
                if not self.sharp:
                    self._keep(solved(self.twins, candidate, theta, BRIEF))

    def _keep(self, fit: Fit) -> None:
        """Keep a fit if it is the best of its candidate."""
        fits, kind = self.choice.fits, fit.unknowns.kind
        if kind not in fits or np.sum(np.log(fit.rms)) < np.sum(np.log(fits[kind].rms)):
            fits[kind] = fit


def chosen(twins: Twins, log: Log, say: Callable[[str], None] = lambda text: None) -> Choice:
    """Fit all candidates to a log; with friction that grows with the torque if the log shows it.

    Each candidate is fitted from several starts, until one explains the log, those first whose filtered rows leave the
    least residual.
    """
    rows, floor = rows_of(twins.model, log), floor_of(log)
    plain, growing = (Candidates(twins, log, Choice({}, floor, log.noise), by_torque) for by_torque in (False, True))
    started = {kind: starts(own, rows) for kind, own in plain.unknowns.items()}
    order = sorted(started, key=lambda kind: started[kind][0][0])
    for attempt in range(STARTS):
        say(f"fitting {', '.join(order)}, start {attempt + 1}")
        plain.fit({kind: started[kind][attempt][1] for kind in order})
        if plain.explained:
            break
        say("fitting with friction that grows with the torque")
        growing.fit_from(plain)
        if growing.explained:
            break
    found = plain
    found.refine()
    if not found.sharp:
        if not growing.choice.fits:
            say("fitting with friction that grows with the torque")
            growing.fit_from(plain)
        growing.refine()
        if _clearer(growing.choice, plain.choice):
            found = growing
    if found.explained and not found.sharp:
        say("fitting, more starts")
        found.again()
        found.refine()
    found.settle()
    return found.choice


def _clearer(other: Choice, found: Choice) -> bool:
    """True if the best fit of `other`, with more unknowns, has the smaller criterion."""
    own, its = found.fits[found.best], other.fits[other.best]
    closest = min((own, its), key=lambda fit: float(np.sum(np.log(fit.rms))))
    return criterion(its, closest.inflation) < criterion(own, closest.inflation)


def _shifted(unknowns: Unknowns, near: Fit) -> Iterator[Array]:
    """Starts with other delays, along the line on which delay and feed-forward have nearly the same effect.

    To first order, a delay that is longer by t and f + a t instead of f give the same torque.
    """
    place = near.unknowns.places["delay"].start
    f, a, _, _ = near.unknowns.family(near.theta[:, None])
    period = unknowns.log.period
    ends = [float(np.mean((end - f) / (a * period))) for end in (0.0, 1.0)]
    for change in (*ends, -2.0, -1.0, 1.0, 2.0):
        delay = near.theta[place] + change
        if 0 <= delay <= MOST_DELAY:
            theta = unknowns.carried(near.unknowns, near.theta)
            theta[unknowns.places["delay"]] = delay
            if "f" in unknowns.places:
                theta[unknowns.places["f"]] = np.clip(f + a * change * period, 0.0, 1.5)[:, 0]
            yield theta
