"""Start values of a fit: linear regression of filtered rows of each joint, over a grid of delays."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from dmframe.identification.log import Log
from dmframe.identification.model import Array, Model
from dmframe.identification.unknowns import Unknowns

DELAYS: Final = np.arange(0, 4.01, 0.5)
"""Delays that are tried [samples]."""
CUTOFF: Final = 8.0
"""Cut-off frequency of the zero-phase filter [Hz]."""
_V_0: Final = 0.01  # [rad/s]
_SPEEDS: Final = (2000.0, 3.0)  # bandwidths of a joint's velocity loop [rad/s]


@final
@dataclass(frozen=True, eq=False)
class Rows:
    """Filtered signals of a log."""

    log: Log
    q: Array
    dq: Array
    torque: Array
    dry: Array

    def commands(self, delay: float) -> tuple[Array, Array]:
        """Filtered dq_c and q_c - q(0), `delay` samples late."""
        late = self.log.time - delay * self.log.period
        q_c = self.log.commanded(late)
        return filtered(self.log, np.gradient(q_c, self.log.time, axis=0)), filtered(self.log, q_c)


def filtered(log: Log, values: Array) -> Array:
    """Zero-phase low-pass of columns."""
    from scipy.signal import butter, sosfiltfilt

    cutoff = min(CUTOFF * 2 * log.period, 0.5)
    return np.asarray(sosfiltfilt(butter(2, cutoff, output="sos"), values, axis=0))


def rows_of(model: Model, log: Log) -> Rows:
    """Filtered columns of the family's equation."""
    log = even(log)
    q = filtered(log, log.q)
    dq = np.gradient(q, log.time, axis=0)
    ddq = np.gradient(dq, log.time, axis=0)
    rows = np.array(model.torque_rows.map(len(q))(q.T, dq.T, ddq.T)).reshape(model.n, len(q), -1)
    torque = filtered(log, np.einsum("jkb,b->kj", rows, model.nominal))
    return Rows(log, filtered(log, q - log.q[0]), filtered(log, dq), torque, filtered(log, np.tanh(dq / _V_0)))


def even(log: Log) -> Log:
    """The log with positions at equal intervals, by linear interpolation, which the filter requires."""
    if np.ptp(np.diff(log.time)) < 1e-3 * log.period:
        return log
    time = np.arange(0.0, log.time[-1], log.period)
    q = np.column_stack([np.interp(time, log.time, column) for column in log.q.T])
    return replace(log, time=time, q=q, sent=log.instants[:-1])


def starts(unknowns: Unknowns, rows: Rows) -> list[tuple[float, Array]]:
    """Start values of theta for each delay, with the sum of the joints' logarithms of residuals; the best first."""
    found = list[tuple[float, Array]]()
    for delay in DELAYS:
        u, q_c = rows.commands(delay)
        theta, score = unknowns.prior[0].copy(), 0.0
        theta[unknowns.places["delay"]] = delay
        for j in range(unknowns.model.n):
            own, values = _joint(unknowns.kind, rows, u[:, j], q_c[:, j], j)
            score += own
            values["w"] = np.log(np.clip(values["w"], *(1 / (speed * unknowns.driven[j]) for speed in _SPEEDS)))
            for name, value in values.items():
                theta[unknowns.places[name]][j] = value
        found.append((score, theta))
    return sorted(found, key=lambda item: item[0])


def _joint(kind: str, rows: Rows, u: Array, q_c: Array, j: int) -> tuple[float, dict[str, float]]:
    """Score and start values of a joint."""
    step = rows.log.period
    q, dq, torque, dry = rows.q[:, j], rows.dq[:, j], rows.torque[:, j], rows.dry[:, j]
    e = q_c - q
    common = [-torque, -dry, np.ones_like(q)]
    if kind in ("pi", "pid"):
        columns = [e, *common, -dq] + ([step * np.cumsum(e)] if kind == "pid" else [])
        score, x = _bounded(columns, dq - u)
        servo = {"k_I": x[0]} if kind == "pi" else {"k_P": x[0], "k_I": x[5]}
        return score, {name: np.log(max(v, 0.05)) for name, v in servo.items()} | _friction(x[1], x[2], x[4])
    columns = [-q, *common, q_c, step * np.cumsum(e)] + ([u] if kind == "p_pi" else [])
    score, x = _bounded(columns, dq)
    b, c = max(x[0], 0.1), max(x[5], 1e-3)
    root = np.sqrt(max(b * b / 4 - c, 0.0))
    f = float(np.clip(x[6], 0.0, 1.5)) if kind == "p_pi" else 0.0
    gains = (b / 2 + root, b / 2 - root)
    p = min(gains, key=lambda p: abs(p + f * (b - p) - x[4]))  # a = p + f i
    found = {"k_p": float(np.log(max(p, 0.05))), "k_i": float(np.log(max(b - p, 0.05)))}
    return score, found | _friction(x[1], x[2], 0.0) | ({"f": f} if kind == "p_pi" else {})


def _friction(w: float, wD: float, wB: float) -> dict[str, float]:
    return {"w": w, "D": wD, "B": wB}


def _bounded(columns: list[Array], y: Array) -> tuple[float, Array]:
    """Non-negative least squares, but for the constant; returns half the log of the mean square and the factors."""
    from scipy.optimize import lsq_linear

    A = np.column_stack([*columns, y])[10:-10]
    R: Array = np.linalg.qr(A, mode="r")  # type: ignore[assignment]  # its stub has the modes with two results
    lower = np.zeros(A.shape[1] - 1)
    lower[3] = -np.inf
    x = lsq_linear(R[:, :-1], R[:, -1], (lower, np.inf)).x
    left = R[:, -1] - R[:, :-1] @ x
    return 0.5 * float(np.log(left @ left / len(A) + 1e-30)), x
