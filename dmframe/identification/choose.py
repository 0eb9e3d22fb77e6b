"""Choice of the servo's class: every candidate is fitted, and compared at one noise model."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from dmframe.identification.log import Log
from dmframe.identification.model import Array
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
        spread = 3 * np.sqrt(np.diag(fit.covariance)[place])  # of several joints, one may well be beyond 2
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
    free = fit.unknowns.places["B"].start  # the candidates differ in the servo's parameters only
    return float(np.sum(2 * effective * np.log(fit.rms)) + free * np.log(max(float(np.sum(effective)), 2.0)))


def floor_of(log: Log) -> Array:
    """Residual of a twin that is exact, of each joint [rad]."""
    error = log.q - log.q[0] - log.commanded(log.time)
    return np.asarray(np.hypot(log.noise, SHARE * np.std(error, axis=0)) + 1e-7)


def chosen(twins: Twins, log: Log, say: Callable[[str], None] = lambda text: None) -> Choice:
    """Fit all candidates to a log, those first whose filtered rows leave the least residual."""
    rows, found = rows_of(twins.model, log), Choice({}, floor_of(log), log.noise)
    unknowns = {kind: Unknowns(twins.model, log, kind) for kind in SERVOS}
    started = {kind: starts(own, rows) for kind, own in unknowns.items()}
    order = sorted(started, key=lambda kind: started[kind][0][0])
    for attempt in range(STARTS):
        for kind in order:
            say(f"fitting {kind}, start {attempt + 1}")
            _fitted(twins, unknowns[kind], started[kind][attempt][1], found)
        if any(map(found.explained, found.fits)):
            break
    _refined(twins, unknowns, found)
    if found.explained(found.best) and not found.sharp(found.best):
        say("fitting, more starts")
        _again(twins, unknowns, found)
        _refined(twins, unknowns, found)
    return found


def _refined(twins: Twins, unknowns: Mapping[str, Unknowns], found: Choice) -> None:
    """Fit the best candidate further, if it explains the log: its rounds may have been few, and the integrator coarse.

    A cascade whose feed-forward is complete is a PID servo: both have to converge before they are compared.
    """
    best = found.fits[found.best]
    if best.unknowns.kind == "p_pi" and np.all(np.abs(best.theta[best.unknowns.places["f"]] - 1) < ABOUT):
        start = unknowns["pid"].carried(best.unknowns, best.theta)
        _kept(found, "pid", solved(twins, unknowns["pid"], start))
        best = found.fits[found.best]
    if found.explained(found.best):
        found.fits[found.best] = solved(twins, best.unknowns, best.theta, step=fine_step(twins, best, found.floor))


def _again(twins: Twins, unknowns: Mapping[str, Unknowns], found: Choice) -> None:
    """Fit from more starts until a fit leaves noise only: with other delays, of all candidates that explain the log."""
    near = found.fits[found.best]
    own = [unknowns[kind] for kind in unknowns if found.explained(kind) or kind == found.best]
    for candidate in own:
        for theta in _shifted(candidate, near):
            if not found.sharp(found.best):
                _kept(found, candidate.kind, solved(twins, candidate, theta, BRIEF))


def _shifted(unknowns: Unknowns, near: Fit) -> Iterator[Array]:
    """Starts with other delays, along the line on which delay and feed-forward have nearly the same effect.

    To first order, a delay that is longer by t and f + a t in place of f give the same torque.
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


def _fitted(twins: Twins, unknowns: Unknowns, start: Array, found: Choice) -> None:
    """Fit a candidate from a start, or from the candidate that explains the log if that is nearer."""
    known = [fit for kind, fit in found.fits.items() if found.explained(kind)]
    if known:
        closest = min(known, key=lambda fit: float(np.sum(np.log(fit.rms))))
        others = [start, unknowns.carried(closest.unknowns, closest.theta)]
        start = min(others, key=lambda theta: total(twins, unknowns, theta))
    _kept(found, unknowns.kind, solved(twins, unknowns, start, BRIEF if known else ROUNDS))


def _kept(found: Choice, kind: str, fit: Fit) -> None:
    """Keep a fit if it is the best of its candidate."""
    if kind not in found.fits or np.sum(np.log(fit.rms)) < np.sum(np.log(found.fits[kind].rms)):
        found.fits[kind] = fit
