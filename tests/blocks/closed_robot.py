"""An arm with friction and a PID servo in Pinocchio and SciPy, independent of dmframe's equations."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
import scipy
from numpy.typing import NDArray

Array = NDArray[np.float64]
V_0 = 0.005  # [rad/s] of Coulomb friction, tanh(dq / V_0)


@dataclass
class ClosedRobot:
    """Pinocchio's model of revolute joints, the friction of each joint, the gains of its servo, and rotors if any."""

    model: Any
    viscous: Array
    coulomb: Array
    K_D: Array
    K_P: Array
    K_I: Array
    rotor: Array | None = None
    data: Any = field(init=False)

    def __post_init__(self) -> None:
        self.data = self.model.createData()
        if self.rotor is not None:
            self.model.armature = self.rotor

    def regressor(self, q: Array, dq: Array, v: Array, a: Array) -> Array:
        """M a + C(q, dq) v + g, with polarised products of two velocities, plus friction."""

        def Y(dq: Array, ddq: Array) -> Array:
            return np.array(pin.computeJointTorqueRegressor(self.model, self.data, q, dq, ddq))

        zero = np.zeros(len(q))
        inertial = Y(zero, a) + (Y(dq + v, zero) - Y(dq, zero) - Y(v, zero) + Y(zero, zero)) / 2
        rotors = [] if self.rotor is None else [np.diag(a)]
        return np.hstack([inertial, *rotors, np.diag(v), np.diag(np.tanh(v / V_0))])

    def held(self, q: Array) -> Array:
        """Equilibrium state: joints, velocities, commands, and the integral that compensates gravity."""
        gravity = np.array(pin.computeGeneralizedGravity(self.model, self.data, q))
        return np.concatenate([q, np.zeros(len(q)), q, -gravity / self.K_I])

    def moved(self, plant: Array, dq_c: Array, period: float) -> Array:
        """Servo and arm over one period with a held command."""

        def rate(_: float, y: Array) -> Array:
            q, dq, q_c, i = y.reshape(4, -1)
            u = -self.K_D * (dq - dq_c) - self.K_P * (q - q_c) - self.K_I * i
            friction = self.viscous * dq + self.coulomb * np.tanh(dq / V_0)
            return np.concatenate([dq, pin.aba(self.model, self.data, q, dq, u - friction), dq_c, q - q_c])

        return np.array(
            scipy.integrate.solve_ivp(rate, (0, period), plant, method="LSODA", rtol=1e-9, atol=1e-11).y[:, -1]
        )
