"""Adaptation of the dynamic parameters by a filtered prediction error."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

import casadi as ca

from dmframe.adaptation import Estimate, Leak, adaptation, start_of
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.certificate import SX, Certificate
from dmframe.linalg import metric, times
from dmframe.parameter import Around, Ball, Box, Diagonal, Gain, Interval, PositiveDefinite, Real, Scalar
from dmframe.port import Port, State


@final
class FilteredAdaptation(AbstractBlock):
    r"""Fits the dynamics to what the servo's command did, without accelerations: indirect adaptation, filtered.

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
        The estimate at the start; left out, the robot's nominal model if `regressor` hands it out, else zero.
    a_d_hat_box : [lower, upper]
        Interval onto which the estimate is projected.
    a_d_hat_ball : [centre, radius]
        Instead of the box, the ball onto which it is projected; with a list for the radius, an ellipsoid.
    leak : 1/s, > 0
        A pull back to the start, absent unless given. See `dmframe.adaptation`.

    Notes
    -----
    `direct` says that the error of a prediction drives the adaptation, not that of the tracking: 0.

    References
    ----------
    [WangTAC2020]_ eqs. (54)-(58); [SlotineLi1991]_ section 9.2.
    """

    inputs: ClassVar[tuple[Port, ...]] = (
        Port("Y_f", "n p", "N m"),
        Port("e_f", "n", "rad/s"),
        Port("a_d_nominal", "p", "", optional=True),
    )
    outputs: ClassVar[tuple[Port, ...]] = (Port("a_d_hat", "p", ""),)
    states: ClassVar[tuple[State, ...]] = (
        State("a_d_hat", "p", "", box="a_d_hat_box", ball="a_d_hat_ball", gain="Gamma"),
    )
    truth: ClassVar[tuple[Port, ...]] = (Port("a_d", "p", ""),)

    Gamma: Gain = PositiveDefinite("p")
    a_d_hat: Diagonal | None = Real("p", default=None)
    a_d_hat_box: Box = Interval("p")
    a_d_hat_ball: Ball = Around("p")
    leak: Scalar | None = Leak()

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        gradient = -times(p.Gamma, u.Y_f.T @ u.e_f)
        return Equations(
            outputs={"a_d_hat": x.a_d_hat},
            rates={"a_d_hat": adaptation(p).rate(gradient, x.a_d_hat, start_of("a_d_hat", p, u.a_d_nominal), u.e_f)},
        )

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """The nominal model, or zero."""
        return {"a_d_hat": u.a_d_nominal}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(2) and (3)."""
        a_d = Estimate(x.a_d_hat, truth.a_d, start_of("a_d_hat", p, u.a_d_nominal), metric(p.Gamma))
        robust = adaptation(p).terms([a_d], u.e_f)
        return Certificate(
            storage=(a_d.storage,),
            dissipation=robust.dissipation,
            excess=robust.excess,
            supply=-ca.dot(u.e_f, u.Y_f @ (x.a_d_hat - truth.a_d)),
            truth={"direct": 0},
        )
