"""Servos of commercial robots, written by hand for a plant of MuJoCo."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Servo(ABC):
    """A servo whose states are rows of n numbers, integrated with the arm; the first is the integrated command q_c.

    Attributes
    ----------
    rows : number of rows
    cycle : period of the servo's own samples [s]; 0 for a servo in continuous time
    """

    rows: int
    cycle: float = 0.0

    @abstractmethod
    def start(self, q: Array, held: Array) -> Array:
        """The states, (rows, n), of an arm at rest at q with the gravity torque `held` [N m]."""

    @abstractmethod
    def law(self, q: Array, dq: Array, x: Array, dq_c: Array) -> tuple[Array, list[Array]]:
        """The torque [N m], and the rate of each row, at a command dq_c [rad/s]."""

    def sample(self, q: Array, dq: Array, x: Array, dq_c: Array) -> Array:
        """The states after one sample of the servo."""
        return x


@dataclass(frozen=True)
class Pid(Servo):
    """tau = -K_D (dq - dq_c) - K_P (q - q_c) - K_I i, with i the integral of q - q_c: eq. (7) of the paper."""

    K_D: Array
    K_P: Array
    K_I: Array
    rows = 2

    def start(self, q: Array, held: Array) -> Array:
        return np.array([q, -held / self.K_I])

    def law(self, q: Array, dq: Array, x: Array, dq_c: Array) -> tuple[Array, list[Array]]:
        q_c, i = x
        error = q - q_c
        return -self.K_D * (dq - dq_c) - self.K_P * error - self.K_I * i, [dq_c, error]


@dataclass(frozen=True)
class Cascade(Servo):
    """P around PI with the fraction f of velocity feed-forward, a filter of the velocity, and a lag of the torque [s].

    The velocity controller receives e_v = f dq_c + k_p (q_c - q) - v, where v follows dq by the filter; the torque
    follows K_v e_v + K_i times the integral of e_v by the lag. A time of 0 means none.
    """

    k_p: Array
    K_v: Array
    K_i: Array
    f: float = 1.0
    velocity_filter: float = 0.0
    torque_lag: float = 0.0
    rows = 4

    def start(self, q: Array, held: Array) -> Array:
        return np.array([q, held / self.K_i, 0 * q, held])

    def law(self, q: Array, dq: Array, x: Array, dq_c: Array) -> tuple[Array, list[Array]]:
        q_c, integral, v, tau = x
        e_v = self.f * dq_c + self.k_p * (q_c - q) - (v if self.velocity_filter else dq)
        demanded = self.K_v * e_v + self.K_i * integral
        filtered = (dq - v) / self.velocity_filter if self.velocity_filter else 0 * q
        lagging = (demanded - tau) / self.torque_lag if self.torque_lag else 0 * q
        return tau if self.torque_lag else demanded, [dq_c, e_v, filtered, lagging]


@dataclass(frozen=True)
class DigitalCascade(Cascade):
    """The same, with both controllers computed once per cycle [s]; the filter and the lag remain continuous."""

    cycle: float = 1e-3
    rows = 5

    def start(self, q: Array, held: Array) -> Array:
        return np.array([*super().start(q, held), held])

    def law(self, q: Array, dq: Array, x: Array, dq_c: Array) -> tuple[Array, list[Array]]:
        _, _, v, tau, demanded = x
        return tau, [dq_c, 0 * q, (dq - v) / self.velocity_filter, (demanded - tau) / self.torque_lag, 0 * q]

    def sample(self, q: Array, dq: Array, x: Array, dq_c: Array) -> Array:
        q_c, integral, v, tau, _ = x
        e_v = self.f * dq_c + self.k_p * (q_c - q) - v
        return np.array([q_c, integral + self.cycle * e_v, v, tau, self.K_v * e_v + self.K_i * integral])
