"""Velocity commands that the robot clips: limits of joints whose positions follow the clipped commands only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from dmframe.identification.log import Array, Log, Unknown
from dmframe.identification.rows import filtered

LAGS: Final = 30
"""Samples by which a position may follow its command."""
CLEAR: Final = 0.5
"""Unexplained motion with clipped commands, relative to that with the recorded ones, with which they are clipped."""
SHARE: Final = 0.02
"""Fraction of the motion that the recorded commands leave unexplained at least if they are clipped."""
ALIKE: Final = 0.1
"""Largest unexplained fraction of the motion with clipped commands."""
UNLIKE: Final = 10.0
"""Fraction that applies if motion and commands have different magnitudes."""
NEAR: Final = 0.03
"""Relative range around a first estimate in which the limit is searched."""
LEVELS: Final = np.linspace(0.2, 1.0, 33)
"""Limits that are tried, relative to the fastest command."""


@final
@dataclass(frozen=True)
class Limit:
    """The fastest velocity of a joint [rad/s], and the fastest command."""

    joint: int
    speed: float
    fastest: float

    def __str__(self) -> str:
        return (
            f"joint {self.joint + 1}: commands reach {self.fastest:.3g} rad/s, and the robot clips them at about "
            f"{self.speed:.3g} rad/s: they are clipped in the simulation, at a limit that is estimated"
        )

    def unknown(self, u: Array) -> Unknown:
        """The deviation of the limit from its first estimate; `u` are the clipped commands."""
        rows = np.flatnonzero(np.abs(u[:, self.joint]) >= self.speed * (1 - 1e-12))
        gains = np.sign(u[rows, self.joint])
        return Unknown(self.joint, tuple(map(int, rows)), tuple(map(float, gains)), 0.1 * self.speed)


def cut(u: Array, limits: Sequence[Limit]) -> Array:
    """The commands, clipped."""
    u = u.copy()
    for limit in limits:
        u[:, limit.joint] = np.clip(u[:, limit.joint], -limit.speed, limit.speed)
    return u


def clipped(t: Array, q: Array, u: Array) -> tuple[Limit, ...]:
    """The limits of joints whose positions follow clipped commands much more closely than the recorded ones."""
    found, steps = list[Limit](), np.diff(t)
    for j in range(q.shape[1]):
        own, fastest = q[:, j] - q[0, j], float(np.max(np.abs(u[:, j])))

        def left(speed: float, j: int = j, own: Array = own) -> float:
            held = np.concatenate([[0.0], np.cumsum(np.clip(u[:, j], -speed, speed) * steps)])
            share, factor, _ = fitted(held, own)
            return share if 0.8 < factor < 1.25 else UNLIKE

        recorded = fitted(np.concatenate([[0.0], np.cumsum(u[:, j] * steps)]), own)[0]
        if recorded < SHARE or fastest == 0:
            continue
        shares = [left(level * fastest) for level in LEVELS]
        best = int(np.argmin(shares))
        if best == len(LEVELS) - 1 or shares[best] >= UNLIKE:
            continue
        from scipy.optimize import minimize_scalar

        between = LEVELS[max(best - 1, 0)] * fastest, LEVELS[best + 1] * fastest
        speed = float(minimize_scalar(left, bounds=between, method="bounded", options={"xatol": 1e-5}).x)
        if left(speed) < min(CLEAR * recorded, ALIKE):
            found.append(Limit(j, refined(t, q, u, j, speed), fastest))
    return tuple(found)


def refined(t: Array, q: Array, u: Array, j: int, speed: float) -> float:
    """The limit of joint j with which a linear equation of the servo leaves the least of the filtered velocity.

    The equation has the columns of all servos of `dmframe.identification.model`, and the positions and accelerations of
    all joints instead of the robot's dynamics.
    """
    from scipy.optimize import minimize_scalar

    plain = Log(t, q, u[:, j : j + 1], np.zeros(1))
    everything = filtered(plain, q - q[0])
    rates = np.gradient(everything, t, axis=0)
    smooth, dq = everything[:, j : j + 1], rates[:, j : j + 1]
    own = np.hstack([everything, np.ones_like(smooth), np.tanh(dq / 0.01), np.gradient(rates, t, axis=0)])

    def left(limit: float) -> float:
        log, found = replace(plain, u=np.clip(plain.u, -limit, limit)), np.inf
        for delay in range(5):
            q_c = filtered(log, log.commanded(t - delay * log.period))
            error = np.cumsum(q_c - smooth, axis=0) * log.period
            A = np.hstack([own, q_c, np.gradient(q_c, t, axis=0), error])[10:-10]
            x = np.linalg.lstsq(A, dq[10:-10], rcond=None)[0]
            found = min(found, float(np.sum((dq[10:-10] - A @ x) ** 2)))
        return found

    between = (1 - NEAR) * speed, (1 + NEAR) * speed
    return float(minimize_scalar(left, bounds=between, method="bounded", options={"xatol": 1e-6 * speed}).x)


def fitted(command: Array, own: Array) -> tuple[float, float, int]:
    """Unexplained fraction, factor and lag [samples] of a position as an affine function of a command."""
    best = (np.inf, 0.0, 0)
    for lag in range(-5, LAGS):
        x, y = (command[: len(command) - lag], own[lag:]) if lag >= 0 else (command[-lag:], own[:lag])
        x, y = x - np.mean(x), y - np.mean(y)
        factor = float(x @ y / max(x @ x, 1e-30))
        left = float(np.sqrt(np.sum((y - factor * x) ** 2) / max(y @ y, 1e-30)))
        if left < best[0] - 1e-9:
            best = left, factor, lag
    return best
