r"""Measured torques or currents against those of the identified robot: the factor that positions do not determine.

With the filtered motion, and m the measured signal of a joint,

.. math::

    m &= k \tau + \mathrm{const}, \\
    \tau &= Y(q, \dot q, \ddot q) \beta + B \dot q
        + (D + S e^{-(\dot q/v_s)^2} + L |\tau|) \tanh(\dot q / v_0).

For torques, k times the identified gains are the absolute ones; for currents, k is the inverse of the motor's constant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from dmframe.identification.log import Array
from dmframe.identification.rows import filtered
from dmframe.identification.solve import Fit, inflation_of

MEASURED = {"tau": "torque", "current": "current"}
"""Optional signals, by the beginnings of their names."""
EDGE = 20
"""Samples left out at both ends, where the filter is inexact."""


@final
@dataclass(frozen=True)
class Factor:
    """Factor k of a joint, with limits of two standard deviations.

    Parameters
    ----------
    signal
        torque or current.
    unexplained
        RMS of what k leaves, relative to the standard deviation of the signal.
    """

    signal: str
    joint: int
    factor: float
    interval: tuple[float, float]
    unexplained: float

    @property
    def summary(self) -> dict[str, Any]:
        """Plain data for JSON."""
        about = {"signal": self.signal, "joint": self.joint + 1, "factor": self.factor}
        return about | {"interval": list(self.interval), "unexplained": self.unexplained}

    def __str__(self) -> str:
        unit = "" if self.signal == "torque" else " A/(N m)"
        low, high = self.interval
        return (
            f"joint {self.joint + 1}: measured {self.signal} is {self.factor:.4g} ({low:.4g} to {high:.4g}){unit} "
            f"times the torque of the identified robot; {100 * self.unexplained:.2g} % unexplained"
        )


def factors(fit: Fit, signals: dict[str, Array]) -> tuple[Factor, ...]:
    """The factors of each measured signal; none for a log of which only a part is used, or with NaN."""
    log, found = fit.unknowns.log, list[Factor]()
    for name, word in MEASURED.items():
        if len(signals.get(name, ())) == len(log.time) and np.all(np.isfinite(signals[name])):
            torque, measured = torque_of(fit)[EDGE:-EDGE], filtered(log, signals[name])[EDGE:-EDGE]
            found += [_factor(word, j, torque[:, j], measured[:, j]) for j in range(torque.shape[1])]
    return tuple(found)


def torque_of(fit: Fit) -> Array:
    """Filtered torque of the identified robot along the recorded motion (N, n)."""
    log, model = fit.unknowns.log, fit.unknowns.model
    p = fit.unknowns.numbers(fit.theta[:, None], 0.0)[:, 0]
    number = {name: p[place] for name, place in model.places.items()}
    q = filtered(log, log.q)
    dq = np.gradient(q, log.time, axis=0)
    ddq = np.gradient(dq, log.time, axis=0)
    rows = np.array(model.torque_rows.map(len(q))(q.T, dq.T, ddq.T)).reshape(model.n, len(q), -1)
    slow = np.exp(-((dq / number["v_s"]) ** 2))
    sign = np.tanh(dq / number["v_0"])
    tau = np.einsum("jkb,b->kj", rows, number["beta"]) + number["B"] * dq + (number["D"] + number["S"] * slow) * sign
    return filtered(log, tau / (1 - number["L"] * np.sign(tau) * sign))  # L < 1: tau has the sign of the rest


def _factor(signal: str, j: int, torque: Array, measured: Array) -> Factor:
    """Least squares with a constant; the interval has the residual's autocorrelation."""
    own, y = torque - np.mean(torque), measured - np.mean(measured)
    power = max(float(own @ own), 1e-300)
    factor = float(own @ y) / power
    left = y - factor * own
    deviation = float(np.std(left)) / np.sqrt(power) * float(inflation_of(left[:, None])[0])
    share = float(np.std(left) / max(np.std(y), 1e-300))
    return Factor(signal, j, factor, (factor - 2 * deviation, factor + 2 * deviation), share)
