"""Observer of the task position without task velocity."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

import casadi as ca

from dmframe.block import (
    SX,
    AbstractBlock,
    Certificate,
    Consumed,
    Equations,
    Input,
    Output,
    Positive,
    Scalar,
    Signals,
    Square,
    State,
    named,
)


@final
class TaskObserver(AbstractBlock):
    r"""Predicts the tool position from the reference motion and corrects it with the measured position.

    .. math::

        \dot x_o = \hat J \dot q_r - \beta \hat J \hat J^\top \Delta x_o, \quad \Delta x_o = x_o - x   \tag{1}

    With :math:`a = \hat J^\top \Delta x_o` and :math:`s = \dot q - \dot q_r` it forms a cascade with the servo level.
    Its cross term is :math:`|s|^2/\beta`. The part :math:`\tfrac34 \beta |a|^2` of its dissipation is supplied to the
    reference generator:

    .. math::

        S &= \tfrac12 |\Delta x_o|^2   \tag{2} \\
        \dot S &= -\beta |\tfrac12 a + s/\beta|^2 - \tfrac34 \beta |a|^2 + \tfrac1\beta |s|^2
                  + \Delta x_o^\top (\hat J \dot q - \dot x)   \tag{3}

    Parameters
    ----------
    beta : scalar, rad^2/(m^2 s), > 0
        Observer gain; the proof requires :math:`\beta > 4 \gamma/9`, with :math:`\gamma` of the reference
        generator.

    References
    ----------
    [WangTAC2020]_ eqs. (19), (26).
    """

    renamed: ClassVar[Mapping[str, str]] = {"dq_ref": "dq_r"}
    inputs = (
        Input("x", "m", "m"),
        Input("J_hat", "m n", "m/rad"),
        Input("dq_r", "n", "rad/s"),
    )
    outputs = (Output("x_o", "m", "m"),)
    states = (State("x_o", "m", "m"),)
    truth = (Input("dx", "m", "m/s"), Input("dq", "n", "rad/s"))

    beta: Scalar = Positive("", "rad^2/(m^2 s)")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        back = u.J_hat.T @ (x.x_o - u.x)
        return Equations(outputs={"x_o": x.x_o}, rates={"x_o": u.J_hat @ (u.dq_r - p.beta * back)})

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """The measured position."""
        return {"x_o": u.x}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(2) and (3)."""
        x_o_err, s = x.x_o - u.x, named("s", truth.dq - u.dq_r)
        a = u.J_hat.T @ x_o_err
        exchange = ca.dot(x_o_err, u.J_hat @ truth.dq - truth.dx) - 3 * p.beta / 4 * ca.dot(a, a)
        return Certificate(
            storage=(Square(x_o_err),),
            dissipation=(Square(a / 2 + s / p.beta, p.beta),),
            supply=exchange,
            consumes=Consumed(s, 1 / p.beta),
            truth={"beta": p.beta},
        )
