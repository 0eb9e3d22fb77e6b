"""The adaptive controller in NumPy and Pinocchio, as used by the Python tools: every block's equations by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from tests.benchmarks.loop import Array, Loop

STATES = ("a_d_hat", "q_r", "z", "w", "w_P", "w_I")


class Controller:
    """One sampled controller; its states advance by an explicit Euler step of T."""

    def __init__(self, loop: Loop) -> None:
        self.loop, self.model, self.data = loop, loop.model, loop.model.createData()
        self.weightless: Any = loop.model.copy()
        self.weightless.gravity = pin.Motion.Zero()
        self.weightless_data = self.weightless.createData()
        self.lower = {key: box[0] for key, box in loop.boxes.items()}
        self.upper = {key: box[1] for key, box in loop.boxes.items()}
        self.boxed = any(np.isfinite(box).any() for box in loop.boxes.values())
        self.gain = loop.gains
        self.gamma = float(loop.gains["gamma"])
        self.reset()

    def reset(self) -> None:
        """Reset the states to t = 0."""
        for name in STATES:
            setattr(self, name, self.loop.start[name].copy())

    def regressor(self, q: Array, dq: Array, dq_ref: Array, ddq_ref: Array) -> Array:
        """The Slotine-Li regressor by polarisation.

        The Coriolis terms of Y(q, v, .) are a quadratic form in v, so the bilinear form of dq and dq_ref is that of
        their half sum less that of their half difference: two calls, the second without gravity.
        """
        Y = pin.computeJointTorqueRegressor(self.model, self.data, q, (dq + dq_ref) / 2, ddq_ref)
        less = pin.computeJointTorqueRegressor(
            self.weightless, self.weightless_data, q, (dq - dq_ref) / 2, np.zeros_like(q)
        )
        return np.asarray(Y - less)

    def reference(self, t: float, q: Array, dq: Array) -> tuple[Array, Array]:
        """dq_r = J^+ dx_d - gamma J'(x - x_d), and its derivative along the motion."""
        pin.computeJointJacobiansTimeVariation(self.model, self.data, q, dq)
        pin.updateFramePlacement(self.model, self.data, self.loop.tool)
        x = self.data.oMf[self.loop.tool].translation
        axes = pin.LOCAL_WORLD_ALIGNED
        J = pin.getFrameJacobian(self.model, self.data, self.loop.tool, axes)[:3]
        dJ = pin.getFrameJacobianTimeVariation(self.model, self.data, self.loop.tool, axes)[:3]
        x_d, dx_d, ddx_d = self.loop.desired(t)
        A = np.linalg.inv(J @ J.T)
        error, rate = x - x_d, J @ dq - dx_d
        forward = A @ dx_d
        turn = dJ @ J.T
        dforward = A @ (ddx_d - (turn + turn.T) @ forward)
        dq_r = J.T @ (forward - self.gamma * error)
        ddq_r = dJ.T @ (forward - self.gamma * error) + J.T @ (dforward - self.gamma * rate)
        return dq_r, ddq_r

    def step(self, t: float, q: Array, dq: Array, q_c: Array) -> Array:
        """The command dq_c from the measurements at t; then the states advance to t + T."""
        gain, T = self.gain, self.loop.T
        dq_r, ddq_r = self.reference(t, q, dq)
        dq_ref, ddq_ref = dq_r - gain["K_c"] * (q - self.q_r), ddq_r - gain["K_c"] * (dq - dq_r)
        sigma = dq - dq_ref
        Y_d = np.hstack(
            [self.regressor(q, dq, dq_ref, ddq_ref), np.diag(dq_ref), np.diag(np.tanh(dq_ref / self.loop.v_0))]
        )
        tau = Y_d @ self.a_d_hat
        e_c = q_c - self.q_r
        dq_c = dq_ref - self.w_P * e_c + self.w * tau - self.w_I * self.z
        self.a_d_hat = self.a_d_hat - T * gain["Gamma"] * (Y_d.T @ sigma)
        self.w = self.w - T * gain["Lambda"] * tau * sigma
        self.w_P = self.w_P + T * gain["Lambda_P"] * e_c * sigma
        self.w_I = self.w_I + T * gain["Lambda_I"] * self.z * sigma
        self.z = self.z + T * e_c
        self.q_r = self.q_r + T * dq_r
        if self.boxed:
            for name in self.lower:
                setattr(self, name, np.clip(getattr(self, name), self.lower[name], self.upper[name]))
        return np.asarray(dq_c)


class Plant:
    """The manufacturer's PID servo and the robot with friction: x = (q_c, i, q, dq)."""

    def __init__(self, loop: Loop) -> None:
        self.loop, self.n = loop, loop.n
        self.model, self.data = loop.model, loop.model.createData()
        self.start = np.concatenate([loop.start[name] for name in ("q_c", "i", "q", "dq")])

    def rate(self, x: Array, dq_c: Array) -> Array:
        """dx/dt for a given command."""
        loop, n = self.loop, self.n
        q, dq = x[2 * n : 3 * n], x[3 * n :]
        error = q - x[:n]
        torque = -loop.K_D * (dq - dq_c) - loop.K_P * error - loop.K_I * x[n : 2 * n]
        torque -= loop.B * dq + loop.D * np.tanh(dq / loop.v_0)
        out = np.empty_like(x)
        out[:n], out[n : 2 * n], out[2 * n : 3 * n] = dq_c, error, dq
        out[3 * n :] = pin.aba(self.model, self.data, q, dq, torque)
        return out
