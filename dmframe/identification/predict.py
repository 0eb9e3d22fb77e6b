"""Prediction of the intervals that an excitation will give, from the twin's sensitivities with a nominal servo."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from dmframe.common.errors import ValueFault
from dmframe.identification.choose import SHARE
from dmframe.identification.excitation import Excitation
from dmframe.identification.log import Array, Log
from dmframe.identification.model import Model
from dmframe.identification.solve import STEP
from dmframe.identification.twin import Twins, schedule
from dmframe.identification.unknowns import Unknowns

K_P: Final = 5.0
"""Position gain of the nominal servo, relative to its velocity gain [1/s]."""
K_I: Final = 4.0
"""Integral gain, relative to the velocity gain [1/s^2]."""
BANDWIDTH: Final = 80.0
"""Bandwidth of the velocity loop at the start [rad/s]."""
DRY: Final = 0.01
"""Coulomb friction relative to the velocity gain [rad/s]."""
NOISE: Final = 2e-5
"""Standard deviation of measured positions [rad]: an encoder of 17 bits."""


@final
@dataclass(frozen=True, eq=False)
class Predicted:
    """Half intervals, two standard deviations, for a PID servo with noise of an encoder of 17 bits.

    Parameters
    ----------
    k_P, k_I
        (n,), relative to the gains.
    delay
        [samples].
    """

    k_P: Array
    k_I: Array
    delay: float


def predicted(twins: Twins, plan: Excitation) -> Predicted:
    """The intervals of an excitation for the nominal servo."""
    log = Log(plan.time, np.tile(plan.start, (plan.count, 1)), plan.dq_c[:-1], 0 * plan.start)
    unknowns, model = Unknowns(twins.model, log, "pid"), twins.model
    theta = _nominal(unknowns, model)
    columns = np.hstack([theta[:, None], theta[:, None] + STEP * np.eye(len(theta))])
    segments = schedule(log, log.period)
    q = twins.positions(segments, unknowns.numbers(columns, log.period))
    if not np.all(np.isfinite(q)):
        raise ValueFault(f"{model.chain.name}: the nominal servo diverges with this robot; check its masses")
    error = q[:, :, 0] - plan.q_c
    weight = 1 / np.hypot(NOISE, SHARE * np.std(error, axis=0))
    J = (q[:, :, 1:] - q[:, :, :1]) / STEP * weight[None, :, None]
    precision = np.where(np.isinf(unknowns.prior[1]), 0.0, 1 / unknowns.prior[1] ** 2)
    H = np.einsum("ijk,ijl->kl", J, J) + np.diag(precision)
    size = np.sqrt(np.maximum(np.diag(H), 1e-12))
    half = 2 * np.sqrt(np.diag(np.linalg.pinv(H / np.outer(size, size), hermitian=True))) / size
    at = unknowns.places
    return Predicted(half[at["k_P"]], half[at["k_I"]], float(half[at["delay"]][0]))


def _nominal(unknowns: Unknowns, model: Model) -> Array:
    theta, at = unknowns.prior[0].copy(), unknowns.places
    inertia = np.maximum(unknowns.inertia, 0.02 * np.max(unknowns.inertia))  # rotors of a light wrist
    theta[at["w"]] = -np.log(BANDWIDTH * inertia)
    theta[at["k_P"]], theta[at["k_I"]], theta[at["D"]], theta[at["delay"]] = np.log(K_P), np.log(K_I), DRY, 1.0
    return theta
