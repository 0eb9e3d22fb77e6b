"""Adaptation of the dynamic parameters by a filtered prediction error."""

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
class FilteredAdaptation(AdaptingBlock):
    r"""Indirect adaptation by a filtered prediction error of the servo's command, without accelerations.

    .. math::

        \dot{\hat a}_d = -\Gamma Y_f^\top e_f                  \tag{1}

    With :math:`\tilde a_d = \hat a_d - a_d`:

    .. math::

        S &= \tfrac12 |\tilde a_d|^2_{\Gamma^{-1}}              \tag{2} \\
        \dot S &= -e_f^\top Y_f \tilde a_d                        \tag{3}

    Parameters
    ----------
    Gamma : (p, p), positive definite, or its diagonal
        Adaptation gain.
    a_d_hat : (p,)
        Initial estimate; by default the nominal model if `regressor` outputs it, else zero.

    Notes
    -----
    The output `direct` is 0: a prediction error drives the adaptation, not the tracking error.

    References
    ----------
    [WangTAC2020]_ eqs. (54)-(58); [SlotineLi1991]_ section 9.2.
    """

    inputs = (
        Input("Y_f", "n p", "N m"),
        Input("e_f", "n", "rad/s"),
        Input("a_d_nominal", "p", "", optional=True),
    )
    outputs = (Output("a_d_hat", "p", ""),)
    estimates = (Adapted("a_d_hat", "p", gain="Gamma", nominal="a_d_nominal", ball=True),)
    truth = (Input("a_d", "p", ""),)
    driven_by: ClassVar[str] = "e_f"

    Gamma: Gain = PositiveDefinite("p")
    a_d_hat: Diagonal | None = Real("p", default=None)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The estimate, whose rate is (1)."""
        return Equations(outputs={"a_d_hat": x.a_d_hat})

    def direction(self, u: Signals, x: Signals, p: Signals, e_f: SX) -> Mapping[str, SX]:
        """(1), but for the gain."""
        return {"a_d_hat": -u.Y_f.T @ e_f}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(2) and (3)."""
        return Certificate(
            estimates={"a_d_hat": TrueValue(truth.a_d)},
            supply=-ca.dot(u.e_f, u.Y_f @ (x.a_d_hat - truth.a_d)),
            truth={"direct": 0},
        )
