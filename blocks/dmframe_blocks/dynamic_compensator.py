"""Gradient adaptation of a manipulator's dynamic parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

import casadi as ca

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.certificate import SX, Certificate, Square
from dmframe.parameter import Box, Diagonal, Interval, Positive, Real
from dmframe.port import Port, State


@final
class DynamicCompensator(AbstractBlock):
    r"""Adaptive dynamic compensation along the reference motion.

    .. math::

        \tau_{dc}      &= Y_d \hat a_d + \tau_{task}          \tag{1} \\
        \dot{\hat a}_d &= -\Gamma_d Y_d^\top \sigma           \tag{2}

    With :math:`\tilde a_d = \hat a_d - a_d`, it is lossless from :math:`\sigma` to :math:`-Y_d \tilde a_d`:

    .. math::

        S &= \tfrac12 \tilde a_d^\top \Gamma_d^{-1} \tilde a_d   \tag{3} \\
        \dot S &= -\sigma^\top Y_d \tilde a_d                    \tag{4}

    Parameters
    ----------
    Gamma : diagonal (p,), > 0
        Adaptation gain. Larger adapts faster, passes more velocity noise, and lowers the sampling period up to which
        the loop is stable.
    a_d_hat : (p,)
        The estimate at the start; left out, the robot's nominal model if `regressor` hands it out, else zero.
    a_d_hat_box : [lower, upper]
        Interval onto which the estimate is projected.

    Notes
    -----
    Not for: a plant whose load changes faster than the adaptation.

    References
    ----------
    [WangTAC2020]_ eqs. (12), (15).
    """

    inputs: ClassVar[tuple[Port, ...]] = (
        Port("Y_d", "n p", "N m"),
        Port("sigma", "n", "rad/s"),
        Port("tau_task", "n", "N m", optional=True),
        Port("a_d_nominal", "p", "", optional=True),
    )
    outputs: ClassVar[tuple[Port, ...]] = (Port("tau_dc", "n", "N m"),)
    states: ClassVar[tuple[State, ...]] = (State("a_d_hat", "p", "", box="a_d_hat_box"),)
    truth: ClassVar[tuple[Port, ...]] = (Port("a_d", "p", ""),)

    Gamma: Diagonal = Positive("p")
    a_d_hat: Diagonal | None = Real("p", default=None)
    a_d_hat_box: Box = Interval("p")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        return Equations(
            outputs={"tau_dc": u.Y_d @ x.a_d_hat + u.tau_task},
            rates={"a_d_hat": -p.Gamma * (u.Y_d.T @ u.sigma)},
        )

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """The nominal model, or zero."""
        return {"a_d_hat": u.a_d_nominal}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(3) and (4)."""
        a_d_err = x.a_d_hat - truth.a_d
        return Certificate(
            storage=(Square("a_d_hat - a_d", a_d_err, 1 / p.Gamma),),
            supply=-ca.dot(u.sigma, u.Y_d @ a_d_err),
        )
