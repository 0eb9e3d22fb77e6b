"""Choice of the servo's class: every candidate is fitted, and compared at one noise model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from dmframe.identification.log import Log
from dmframe.identification.model import Array
from dmframe.identification.rows import rows_of, starts
from dmframe.identification.solve import ROUNDS, Fit, solved
from dmframe.identification.twin import Twins
from dmframe.identification.unknowns import SERVOS, Unknowns

STARTS: Final = 3
"""Delays from which a candidate is fitted, as long as its residual is above the floor."""
NEAR: Final = 0.01
"""Deviation of f from 1 that does not count."""
BRIEF: Final = 8
"""Rounds of a candidate after another one has explained the log."""
ABOVE: Final = 3.0
"""Largest residual of an explained log, in floors."""
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
    """

    fits: dict[str, Fit]
    floor: Array

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
        spread = 2 * np.sqrt(np.diag(fit.covariance)[place])
        return bool(np.all(np.abs(fit.theta[place] - 1) <= np.maximum(spread, NEAR)))

    def explained(self, kind: str) -> bool:
        """True if the residual of a candidate is near the floor on every joint."""
        return bool(np.all(self.fits[kind].rms <= ABOVE * self.floor))


def criterion(fit: Fit, inflation: Array) -> float:
    """Bayesian information criterion of a fit, with the effective number of samples of the closest fit."""
    effective = len(fit.residual) / inflation**2
    free = fit.unknowns.places["B"].start  # the candidates differ in the servo's parameters only
    return float(np.sum(2 * effective * np.log(fit.rms)) + free * np.log(max(float(np.sum(effective)), 2.0)))


def floor_of(log: Log) -> Array:
    """Residual of a twin that is exact, of each joint [rad]."""
    q_c = log.q[0] + log.ahead + np.vstack([0 * log.u[:1], np.cumsum(log.u * np.diff(log.time)[:, None], axis=0)])
    return np.asarray(np.hypot(log.noise, SHARE * np.std(log.q - q_c, axis=0)) + 1e-7)


def chosen(twins: Twins, log: Log, say: Callable[[str], None] = lambda text: None) -> Choice:
    """Fit all candidates to a log."""
    rows, found = rows_of(twins.model, log), Choice({}, floor_of(log))
    started = {kind: starts(Unknowns(twins.model, log, kind), rows) for kind in SERVOS}
    for attempt in range(STARTS):
        for kind, some in started.items():
            say(f"fitting {kind}, start {attempt + 1}")
            rounds = BRIEF if any(map(found.explained, found.fits)) else ROUNDS
            fit = solved(twins, Unknowns(twins.model, log, kind), some[attempt][1], rounds)
            if kind not in found.fits or np.sum(np.log(fit.rms)) < np.sum(np.log(found.fits[kind].rms)):
                found.fits[kind] = fit
        if any(map(found.explained, found.fits)):
            break
    if found.explained(found.best):  # its rounds may have been few
        found.fits[found.best] = solved(twins, found.fits[found.best].unknowns, found.fits[found.best].theta)
    return found
