"""Adaptation of the dynamic parameters by the prediction error of the torque."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

import casadi as ca

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.certificate import SX, Certificate, Square
from dmframe.parameter import Box, Diagonal, Interval, Positive, Real
from dmframe.port import Port, State


@final
class IndirectAdaptation(AbstractBlock):
    r"""Fits the dynamics to what the torque did, whatever the torque law.

    .. math::

        \epsilon &= Y_d(q, \dot q, \dot q, \ddot q)\, \hat a_d - \tau_d    \tag{1} \\
        \dot{\hat a}_d &= -\Gamma_d Y_d^\top \epsilon                      \tag{2}

    With :math:`\tilde a_d = \hat a_d - a_d`:

    .. math::

        S &= \tfrac12 |\tilde a_d|^2_{\Gamma_d^{-1}}                                       \tag{3} \\
        \dot S &= -|\epsilon|^2 + \epsilon^\top (\epsilon - Y_d \tilde a_d)                \tag{4}

    Parameters
    ----------
    Gamma : diagonal (p,), > 0
        Adaptation gain.
    a_d_hat : (p,)
        The estimate at the start; left out, the robot's nominal model if `regressor` hands it out, else zero.
    a_d_hat_box : [lower, upper]
        Interval onto which the estimate is projected.

    Notes
    -----
    Not for: a robot whose accelerations are not measured; estimates that start at zero under `certainty_equivalence`,
    where the torque, and so the error, would stay at zero.

    References
    ----------
    [WangTAC2020]_ eqs. (54)-(58).
    """

    inputs: ClassVar[tuple[Port, ...]] = (
        Port("Y_d", "n p", "N m"),
        Port("tau_d", "n", "N m"),
        Port("a_d_nominal", "p", "", optional=True),
    )
    outputs: ClassVar[tuple[Port, ...]] = (Port("a_d_hat", "p", ""), Port("epsilon", "n", "N m"))
    states: ClassVar[tuple[State, ...]] = (State("a_d_hat", "p", "", box="a_d_hat_box"),)
    truth: ClassVar[tuple[Port, ...]] = (Port("a_d", "p", ""),)

    Gamma: Diagonal = Positive("p")
    a_d_hat: Diagonal | None = Real("p", default=None)
    a_d_hat_box: Box = Interval("p")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        epsilon = u.Y_d @ x.a_d_hat - u.tau_d
        return Equations(
            outputs={"a_d_hat": x.a_d_hat, "epsilon": epsilon},
            rates={"a_d_hat": -p.Gamma * (u.Y_d.T @ epsilon)},
        )

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """The nominal model, or zero."""
        return {"a_d_hat": u.a_d_nominal}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(3) and (4)."""
        a_d_err, epsilon = x.a_d_hat - truth.a_d, self.equations(u, x, p).outputs["epsilon"]
        return Certificate(
            storage=(Square("a_d_hat - a_d", a_d_err, 1 / p.Gamma),),
            dissipation=(Square("epsilon", epsilon, ca.SX(1)),),
            supply=ca.dot(epsilon, epsilon - u.Y_d @ a_d_err),
            truth={"direct": ca.SX(0)},
        )
