"""Adaptation of the dynamic parameters by the prediction error of the torque."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

import casadi as ca

from dmframe.adaptation import DeadZone, ErrorLeak, Estimate, Leak, adaptation, start_of
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.certificate import SX, Certificate, Lemma, Square
from dmframe.linalg import metric, times
from dmframe.parameter import Around, Ball, Box, Diagonal, Gain, Interval, PositiveDefinite, Real, Scalar
from dmframe.port import Port, State


@final
class IndirectAdaptation(AbstractBlock):
    r"""Fits the dynamics to what the torque did, whatever the torque law.

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
        The estimate at the start; left out, the robot's nominal model if `regressor` hands it out, else zero.
    a_d_hat_box : [lower, upper]
        Interval onto which the estimate is projected.
    a_d_hat_ball : [centre, radius]
        Instead of the box, the ball onto which it is projected; with a list for the radius, an ellipsoid.
    leak, error_leak, dead_zone : 1/s; 1/(N m s); (n,), N m; > 0
        Robust laws, each absent unless given: a pull back to the start; one in proportion to epsilon; no adaptation
        while epsilon is below this width. See `dmframe.adaptation`.

    Notes
    -----
    Not for: a robot whose accelerations are not measured; estimates that start at zero under `certainty_equivalence`,
    where the torque, and so the error, would stay at zero.

    `direct` says that the error of the torque drives the adaptation, not that of the tracking: 0.

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
    states: ClassVar[tuple[State, ...]] = (
        State("a_d_hat", "p", "", box="a_d_hat_box", ball="a_d_hat_ball", gain="Gamma"),
    )
    truth: ClassVar[tuple[Port, ...]] = (Port("a_d", "p", ""),)

    Gamma: Gain = PositiveDefinite("p")
    a_d_hat: Diagonal | None = Real("p", default=None)
    a_d_hat_box: Box = Interval("p")
    a_d_hat_ball: Ball = Around("p")
    leak: Scalar | None = Leak()
    error_leak: Scalar | None = ErrorLeak("1/(N m s)")
    dead_zone: Diagonal | None = DeadZone("n", "N m")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        law, error = adaptation(p), u.Y_d @ x.a_d_hat - u.tau_d
        epsilon = law.drive(error)
        return Equations(
            outputs={"a_d_hat": x.a_d_hat, "epsilon": epsilon},
            rates={
                "a_d_hat": law.rate(
                    -times(p.Gamma, u.Y_d.T @ epsilon), x.a_d_hat, start_of("a_d_hat", p, u.a_d_nominal), error
                )
            },
        )

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """The nominal model, or zero."""
        return {"a_d_hat": u.a_d_nominal}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(3) and (4)."""
        law, error = adaptation(p), u.Y_d @ x.a_d_hat - u.tau_d
        epsilon = law.drive(error)
        a_d = Estimate(x.a_d_hat, truth.a_d, start_of("a_d_hat", p, u.a_d_nominal), metric(p.Gamma))
        robust = law.terms([a_d], error)
        spent = Square(error) if law.width is None else self._beyond(error, law.width)
        return Certificate(
            storage=(a_d.storage,),
            dissipation=(spent, *robust.dissipation),
            excess=robust.excess,
            supply=ca.dot(epsilon, error - u.Y_d @ (x.a_d_hat - truth.a_d)),
            truth={"direct": 0},
        )

    def _beyond(self, error: SX, width: SX) -> Lemma:
        """The error times what it has beyond its dead zone: everything that reads epsilon stands still inside."""
        return Lemma(width, error, ca.DM.zeros(error.shape[0]), width, "beyond")
