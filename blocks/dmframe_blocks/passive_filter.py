"""First-order filter of the task feedback, passive from task error to joints."""

from __future__ import annotations

from typing import final

import casadi as ca

from dmframe.block import (
    AbstractBlock,
    Certificate,
    Diagonal,
    Equations,
    Input,
    Output,
    Positive,
    Signals,
    Square,
    State,
)


@final
class PassiveFilter(AbstractBlock):
    r"""Filters the transposed-Jacobian feedback, so that no reference requires a task velocity.

    .. math::

        \dot y = -K_1 y + K_1 \hat J^\top \Delta x, \quad \Delta x = x - x_d   \tag{1}

    With :math:`K_2` and :math:`\alpha = \mathrm{task\_weight}` of `filtered_regulation`:

    .. math::

        S &= \tfrac12 \alpha |y|^2_{K_2/K_1}                                        \tag{2} \\
        \dot S &= -\alpha\, y^\top K_2 y + \alpha\, y^\top K_2 \hat J^\top \Delta x \tag{3}

    Parameters
    ----------
    K_1 : diagonal (n,), 1/s, > 0
        Bandwidth of the filter. A larger bandwidth follows the error more closely and passes more noise.

    References
    ----------
    [WangTAC2020]_ eq. (8).
    """

    inputs = (
        Input("x", "m", "m"),
        Input("x_d", "m", "m"),
        Input("J_hat", "m n", "m/rad"),
    )
    outputs = (Output("y", "n", "m^2/rad"),)
    states = (State("y", "n", "m^2/rad"),)
    truth = (Input("K_2", "n", "rad^2/(m^2 s)"), Input("task_weight"))

    K_1: Diagonal = Positive("n", "1/s")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"y": x.y}, rates={"y": p.K_1 * (u.J_hat.T @ (u.x - u.x_d) - x.y)})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(2) and (3)."""
        alpha, K_2 = truth.task_weight, truth.K_2
        return Certificate(
            storage=(Square(x.y, alpha * K_2 / p.K_1),),
            dissipation=(Square(x.y, alpha * K_2),),
            supply=alpha * ca.dot(x.y, K_2 * (u.J_hat.T @ (u.x - u.x_d))),
            task=True,
        )
