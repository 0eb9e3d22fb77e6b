"""Adaptation of the dynamic parameters by the tracking error."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

import casadi as ca

from dmframe.block import (
    SX,
    Adapted,
    AdaptingBlock,
    Assumption,
    Certificate,
    Condition,
    Equations,
    Gain,
    Input,
    Output,
    PositiveDefinite,
    Signals,
    TrueValue,
    sentence,
    solve_spd,
)


@final
class DirectAdaptation(AdaptingBlock):
    r"""Adaptive computed torque: the tracking error, times the inverse estimated mass matrix, drives the estimates.

    .. math::

        \epsilon &= \hat M^{-1} s^\star                       \tag{1} \\
        \dot{\hat a}_d &= -\Gamma Y_d^\top \epsilon    \tag{2}

    With :math:`\tilde a_d = \hat a_d - a_d`:

    .. math::

        S &= \tfrac12 |\tilde a_d|^2_{\Gamma^{-1}}          \tag{3} \\
        \dot S &= -\epsilon^\top Y_d \tilde a_d               \tag{4}

    Parameters
    ----------
    Gamma : (p, p), positive definite, or its diagonal
        Adaptation gain.
    a_d_hat_box : [lower, upper]
        Interval onto which the estimate is projected, so that :math:`\hat M` stays invertible.

    Notes
    -----
    Not for: a robot without a nominal model, which gives the initial estimates: M-hat is singular at zero.

    The output `direct` is 1: the tracking error drives the adaptation.

    References
    ----------
    [WangTAC2020]_ eqs. (59), (60).
    """

    inputs = (
        Input("Y_d", "n p", "N m"),
        Input("M_hat", "n n", "N m s^2/rad"),
        Input("s_star", "n", "rad/s"),
        Input("a_d_nominal", "p", ""),
    )
    outputs = (Output("a_d_hat", "p", ""), Output("epsilon", "n", "rad^2/(N m s^3)"))
    estimates = (Adapted("a_d_hat", "p", gain="Gamma", nominal="a_d_nominal", ball=True),)
    truth = (Input("a_d", "p", ""),)
    driven_by: ClassVar[str] = "epsilon"

    Gamma: Gain = PositiveDefinite("p")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"a_d_hat": x.a_d_hat, "epsilon": solve_spd(u.M_hat, u.s_star)})

    def direction(self, u: Signals, x: Signals, p: Signals, epsilon: SX) -> Mapping[str, SX]:
        """(2), but for the gain."""
        return {"a_d_hat": -u.Y_d.T @ epsilon}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(3) and (4)."""
        epsilon = self.equations(u, x, p).outputs["epsilon"]
        return Certificate(
            estimates={"a_d_hat": TrueValue(truth.a_d)},
            supply=-ca.dot(epsilon, u.Y_d @ (x.a_d_hat - truth.a_d)),
            truth={"direct": 1},
        )

    def conditions(self, p: Signals, truth: Signals) -> tuple[Condition, ...]:
        """M-hat stays invertible."""
        text = sentence("{M_hat} stays uniformly positive definite (a_d_hat_box can keep it so)")
        return (Assumption(text, "eq. (60)"),)
