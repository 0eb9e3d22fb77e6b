"""Reference for regulation to a point in the task space through a passive filter."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

import casadi as ca

from dmframe.block import (
    AbstractBlock,
    Certificate,
    Diagonal,
    Equations,
    Input,
    Output,
    Positive,
    Scalar,
    Signals,
    Square,
)


@final
class FilteredRegulation(AbstractBlock):
    r"""Joint reference from the filtered task error, with a passive task feedback as a torque.

    .. math::

        \dot q_r     &= -K_2 y                                           \tag{1} \\
        \tau_{task}  &= -\alpha \hat J^\top \Delta x                      \tag{2} \\
        e_k          &= \Delta x = x - x_d                                \tag{3}

    Its storage is added to that of the servo level with weight 1; :math:`x_d` is constant:

    .. math::

        S &= \tfrac12 \alpha |\Delta x|^2               \tag{4} \\
        \dot S &= \alpha\, \Delta x^\top \dot x         \tag{5}

    Parameters
    ----------
    K_2 : diagonal (n,), rad^2/(m^2 s), > 0
        Gain from the filtered error to the reference velocity.
    alpha : scalar, N/m, > 0
        Stiffness of the task feedback, which acts as a torque through the servo.

    Notes
    -----
    Not for: a moving goal; see `observed_tracking`. Use it with ``tie: position`` of `pid_inverse`: its energy balance
    requires :math:`\dot q_{ref} = -K_2 y`.

    `task_weight` is the weight of the task level in V.

    References
    ----------
    [WangTAC2020]_ eqs. (9), (12), (13), Theorem 1.
    """

    renamed: ClassVar[Mapping[str, str]] = {"dq_ref": "dq_r"}
    inputs = (
        Input("y", "n", "m^2/rad"),
        Input("x", "m", "m"),
        Input("x_d", "m", "m"),
        Input("J_hat", "m n", "m/rad"),
    )
    outputs = (
        Output("dq_r", "n", "rad/s"),
        Output("tau_task", "n", "N m"),
        Output("e_k", "m", "m"),
    )
    truth = (Input("dx", "m", "m/s"),)

    K_2: Diagonal = Positive("n", "rad^2/(m^2 s)")
    alpha: Scalar = Positive("", "N/m")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1), (2) and (3)."""
        e_k = u.x - u.x_d
        return Equations(outputs={"dq_r": -p.K_2 * u.y, "tau_task": -p.alpha * (u.J_hat.T @ e_k), "e_k": e_k})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(4) and (5)."""
        x_err = u.x - u.x_d
        return Certificate(
            storage=(Square(x_err, p.alpha),),
            supply=p.alpha * ca.dot(x_err, truth.dx),
            task=True,
            truth={"task_weight": p.alpha, "K_2": p.K_2},
        )
