"""Reference for tracking in the task space with uncertain kinematics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, final

import casadi as ca

from dmframe.block import (
    AbstractBlock,
    Certificate,
    Condition,
    Consumed,
    Equations,
    Inequality,
    Input,
    Output,
    Positive,
    Scalar,
    Signals,
    Square,
    named,
    solve_spd,
)


@final
class ObservedTracking(AbstractBlock):
    r"""Joint reference velocity from the observed instead of the measured position; regulation for a constant goal.

    .. math::

        \dot q_r &= \hat J^+ \dot x_d - \gamma \hat J^\top (x_o - x_d) + (I - \hat J^+ \hat J)\, \dot q_{null}, \quad
        \hat J^+ = \hat J^\top (\hat J \hat J^\top)^{-1}                                   \tag{1} \\
        e_k &= \Delta x - \Delta x_o, \quad \Delta x = x - x_d, \quad \Delta x_o = x_o - x         \tag{2}

    :math:`\dot q_{null}` moves a redundant robot in the null space of :math:`\hat J`: see `null_space_posture`. The
    input is optional.

    With :math:`a = \hat J^\top \Delta x_o`, :math:`b = \hat J^\top \Delta x`, :math:`s = \dot q - \dot q_r` it forms a
    cascade with the servo level:

    .. math::

        S &= \tfrac12 |\Delta x|^2   \tag{3} \\
        \dot S &= -(\tfrac34 \beta |a|^2 + \gamma a^\top b + \tfrac34 \gamma |b|^2)
                  - \gamma |\tfrac12 b - s/\gamma|^2 + \tfrac34 \beta |a|^2 + \tfrac1\gamma |s|^2
                  - \Delta x^\top (\hat J \dot q - \dot x)   \tag{4}

    Parameters
    ----------
    gamma : scalar, rad^2/(m^2 s), > 0
        Task gain; the proof requires :math:`\gamma < 9 \beta/4`, with :math:`\beta` of the observer.

    Notes
    -----
    `task_weight` is the weight of the task level in V.

    References
    ----------
    [WangTAC2020]_ eqs. (20), (22), (30), (31), Theorems 2 and 3.
    """

    renamed: ClassVar[Mapping[str, str]] = {"z": "dq_null", "dq_ref": "dq_r"}
    inputs = (
        Input("x", "m", "m"),
        Input("x_o", "m", "m"),
        Input("x_d", "m", "m"),
        Input("dx_d", "m", "m/s", derivative_of="x_d"),
        Input("J_hat", "m n", "m/rad"),
        Input("dq_null", "n", "rad/s", optional=True),
    )
    outputs = (Output("dq_r", "n", "rad/s"), Output("e_k", "m", "m"))
    truth = (
        Input("dq", "n", "rad/s"),
        Input("dx", "m", "m/s"),
        Input("beta", "", "rad^2/(m^2 s)"),
    )

    gamma: Scalar = Positive("", "rad^2/(m^2 s)")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        forward = solve_spd(u.J_hat @ u.J_hat.T, u.dx_d - u.J_hat @ u.dq_null)
        dq_r = u.J_hat.T @ (forward - p.gamma * (u.x_o - u.x_d)) + u.dq_null
        return Equations(outputs={"dq_r": dq_r, "e_k": (u.x - u.x_d) - (u.x_o - u.x)})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(3) and (4)."""
        x_err = u.x - u.x_d
        s = named("s", truth.dq - self.equations(u, x, p).outputs["dq_r"])
        a, b = u.J_hat.T @ (u.x_o - u.x), u.J_hat.T @ x_err
        one = ca.DM.eye(a.numel())
        Q = ca.blockcat([[3 * truth.beta / 4 * one, p.gamma / 2 * one], [p.gamma / 2 * one, 3 * p.gamma / 4 * one]])
        exchange = 3 * truth.beta / 4 * ca.dot(a, a) - ca.dot(x_err, u.J_hat @ truth.dq - truth.dx)
        return Certificate(
            storage=(Square(x_err),),
            dissipation=(
                Square(ca.vertcat(a, b), Q),
                Square(b / 2 - s / p.gamma, p.gamma),
            ),
            supply=exchange,
            consumes=Consumed(s, 1 / p.gamma),
            truth={"task_weight": 1},
        )

    def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        """The observer must be fast enough for the task."""
        return (Inequality("beta > 4 gamma/9", truth.beta - 4 * p.gamma / 9, "eqs. (26), (31)"),)
