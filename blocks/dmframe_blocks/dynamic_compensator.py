"""Gradient adaptation of a manipulator's dynamic parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

import casadi as ca

from dmframe.block import (
    SX,
    Adapted,
    AdaptingBlock,
    Certificate,
    Diagonal,
    Equations,
    Gain,
    Input,
    Output,
    PositiveDefinite,
    Real,
    Signals,
    TrueValue,
)


@final
class DynamicCompensator(AdaptingBlock):
    r"""Adaptive dynamic compensation along the reference motion.

    .. math::

        \tau_{dc}      &= Y_d \hat a_d + \tau_{known} + \tau_{task}          \tag{1} \\
        \dot{\hat a}_d &= -\Gamma (Y_d^\top \sigma + Y_f^\top e_f)   \tag{2}

    :math:`\tau_{known}` is the part of the torque that needs no estimates, for example from `payload_regressor`. The
    term in :math:`e_f` is that of composite adaptation with a `filtered_regressor` in the graph, and zero otherwise.
    With :math:`\tilde a_d = \hat a_d - a_d`, the block is lossless from :math:`\sigma` to :math:`-Y_d \tilde a_d`:

    .. math::

        S &= \tfrac12 |\tilde a_d|^2_{\Gamma^{-1}}   \tag{3} \\
        \dot S &= -\sigma^\top Y_d \tilde a_d - e_f^\top Y_f \tilde a_d   \tag{4}

    Parameters
    ----------
    Gamma : (p, p), positive definite, or its diagonal
        Adaptation gain. A larger gain adapts faster, passes more velocity noise, and reduces the largest stable
        sampling period.
    a_d_hat : (p,)
        Initial estimate; by default the nominal model if `regressor` outputs it, else zero.

    Notes
    -----
    Not for: a plant whose load changes faster than the adaptation.

    References
    ----------
    [WangTAC2020]_ eqs. (12), (15).
    """

    inputs = (
        Input("Y_d", "n p", "N m"),
        Input("sigma", "n", "rad/s"),
        Input("tau_task", "n", "N m", optional=True),
        Input("tau_known", "n", "N m", optional=True),
        Input("a_d_nominal", "p", "", optional=True),
        Input("Y_f", "n p", "N m", optional=True),
        Input("e_f", "n", "rad/s", optional=True),
    )
    outputs = (Output("tau_dc", "n", "N m"), Output("a_d_hat", "p", ""))
    estimates = (Adapted("a_d_hat", "p", gain="Gamma", nominal="a_d_nominal", ball=True),)
    truth = (Input("a_d", "p", ""),)
    driven_by: ClassVar[str] = "sigma"

    Gamma: Gain = PositiveDefinite("p")
    a_d_hat: Diagonal | None = Real("p", default=None)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"tau_dc": u.Y_d @ x.a_d_hat + u.tau_known + u.tau_task, "a_d_hat": x.a_d_hat})

    def direction(self, u: Signals, x: Signals, p: Signals, sigma: SX) -> Mapping[str, SX]:
        """(2), but for the gain."""
        return {"a_d_hat": -(u.Y_d.T @ sigma + u.Y_f.T @ u.e_f)}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(3) and (4)."""
        a_d_err = x.a_d_hat - truth.a_d
        return Certificate(
            estimates={"a_d_hat": TrueValue(truth.a_d)},
            supply=-ca.dot(u.sigma, u.Y_d @ a_d_err) - ca.dot(u.e_f, u.Y_f @ a_d_err),
        )
