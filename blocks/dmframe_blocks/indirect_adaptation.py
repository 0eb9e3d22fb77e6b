"""Adaptation of the dynamic parameters by the prediction error of the torque."""

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
    Lemma,
    Output,
    PositiveDefinite,
    Real,
    Signals,
    Square,
    TrueValue,
)


@final
class IndirectAdaptation(AdaptingBlock):
    r"""Indirect adaptation: fits the dynamics to the applied torque, for any torque law.

    .. math::

        \epsilon &= Y_d \hat a_d - \tau_d                \tag{1} \\
        \dot{\hat a}_d &= -\Gamma Y_d^\top \epsilon    \tag{2}

    With :math:`\tilde a_d = \hat a_d - a_d`:

    .. math::

        S &= \tfrac12 |\tilde a_d|^2_{\Gamma^{-1}}                                       \tag{3} \\
        \dot S &= -|\epsilon|^2 + \epsilon^\top (\epsilon - Y_d \tilde a_d)                \tag{4}

    Parameters
    ----------
    Gamma : (p, p), positive definite, or its diagonal
        Adaptation gain.
    a_d_hat : (p,)
        Initial estimate; by default the nominal model if `regressor` outputs it, else zero.

    Notes
    -----
    Not for: a robot whose accelerations are not measured; zero initial estimates with `certainty_equivalence`, for
    which the torque, and with it the error, would stay zero.

    The output `direct` is 0: the prediction error of the torque drives the adaptation, not the tracking error.

    References
    ----------
    [WangTAC2020]_ eqs. (54)-(58).
    """

    inputs = (
        Input("Y_d", "n p", "N m"),
        Input("tau_d", "n", "N m"),
        Input("a_d_nominal", "p", "", optional=True),
    )
    outputs = (Output("a_d_hat", "p", ""), Output("epsilon", "n", "N m"))
    estimates = (Adapted("a_d_hat", "p", gain="Gamma", nominal="a_d_nominal", ball=True),)
    truth = (Input("a_d", "p", ""),)
    driven_by: ClassVar[str] = "epsilon"
    ignores_at_source: ClassVar[bool] = True

    Gamma: Gain = PositiveDefinite("p")
    a_d_hat: Diagonal | None = Real("p", default=None)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"a_d_hat": x.a_d_hat, "epsilon": self.driven(self.error(u, x, p), p)})

    def error(self, u: Signals, x: Signals, p: Signals) -> SX:
        """(1), before a dead zone; inside the dead zone all blocks that read epsilon stop adapting."""
        return u.Y_d @ x.a_d_hat - u.tau_d

    def direction(self, u: Signals, x: Signals, p: Signals, epsilon: SX) -> Mapping[str, SX]:
        """(2), but for the gain."""
        return {"a_d_hat": -u.Y_d.T @ epsilon}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(3) and (4)."""
        error = self.error(u, x, p)
        return Certificate(
            estimates={"a_d_hat": TrueValue(truth.a_d)},
            dissipation=(self._spent(error, p),),
            supply=ca.dot(self.driven(error, p), error - u.Y_d @ (x.a_d_hat - truth.a_d)),
            truth={"direct": 0},
        )

    def _spent(self, error: SX, p: Signals) -> Square | Lemma:
        """The product of the error before and after its dead zone."""
        if "dead_zone" not in p:
            return Square(error)
        return Lemma(p.dead_zone, error, ca.DM.zeros(error.shape[0]), p.dead_zone, "beyond")
