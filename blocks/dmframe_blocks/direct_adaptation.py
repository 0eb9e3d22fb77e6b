"""Adaptation of the dynamic parameters by the tracking error."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

import casadi as ca

from dmframe.adaptation import DeadZone, ErrorLeak, Estimate, Leak, adaptation
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.certificate import SX, Assumption, Certificate, Condition
from dmframe.linalg import metric, solve_spd, times
from dmframe.parameter import Around, Ball, Box, Diagonal, Gain, Interval, PositiveDefinite, Scalar
from dmframe.port import Port, State


@final
class DirectAdaptation(AbstractBlock):
    r"""Adaptive computed torque: the tracking error, seen through the estimated mass matrix, drives the estimates.

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
        Interval onto which the estimate is projected, to keep M-hat invertible.
    a_d_hat_ball : [centre, radius]
        Instead of the box, the ball onto which it is projected; with a list for the radius, an ellipsoid.
    leak, error_leak, dead_zone : 1/s; a rate a unit of the error; (n,), rad^2/(N m s^3); > 0
        Robust laws, each absent unless given: a pull back to the start; one in proportion to epsilon; no adaptation
        while epsilon is below this width. See `dmframe.adaptation`.

    Notes
    -----
    Not for: a robot without a nominal model, at which the estimates start: M-hat is singular at zero.

    `direct` says that the tracking error drives the adaptation: 1.

    References
    ----------
    [WangTAC2020]_ eqs. (59), (60).
    """

    inputs: ClassVar[tuple[Port, ...]] = (
        Port("Y_d", "n p", "N m"),
        Port("M_hat", "n n", "N m s^2/rad"),
        Port("s_star", "n", "rad/s"),
        Port("a_d_nominal", "p", ""),
    )
    outputs: ClassVar[tuple[Port, ...]] = (Port("a_d_hat", "p", ""), Port("epsilon", "n", "rad^2/(N m s^3)"))
    states: ClassVar[tuple[State, ...]] = (
        State("a_d_hat", "p", "", box="a_d_hat_box", ball="a_d_hat_ball", gain="Gamma"),
    )
    truth: ClassVar[tuple[Port, ...]] = (Port("a_d", "p", ""),)

    Gamma: Gain = PositiveDefinite("p")
    a_d_hat_box: Box = Interval("p")
    a_d_hat_ball: Ball = Around("p")
    leak: Scalar | None = Leak()
    error_leak: Scalar | None = ErrorLeak()
    dead_zone: Diagonal | None = DeadZone("n", "rad^2/(N m s^3)")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        law, epsilon = adaptation(p), solve_spd(u.M_hat, u.s_star)
        gradient = -times(p.Gamma, u.Y_d.T @ law.drive(epsilon))
        return Equations(
            outputs={"a_d_hat": x.a_d_hat, "epsilon": epsilon},
            rates={"a_d_hat": law.rate(gradient, x.a_d_hat, u.a_d_nominal, epsilon)},
        )

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """The nominal model."""
        return {"a_d_hat": u.a_d_nominal}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(3) and (4)."""
        law, epsilon = adaptation(p), self.equations(u, x, p).outputs["epsilon"]
        effect = u.Y_d @ (x.a_d_hat - truth.a_d)
        a_d = Estimate(x.a_d_hat, truth.a_d, u.a_d_nominal, metric(p.Gamma))
        robust = law.terms([a_d], epsilon) + law.idle(epsilon, effect)
        return Certificate(
            storage=(a_d.storage,),
            dissipation=robust.dissipation,
            excess=robust.excess,
            supply=-ca.dot(epsilon, effect),
            truth={"direct": 1},
        )

    def conditions(self, p: Signals, truth: Signals) -> tuple[Condition, ...]:
        """M-hat stays invertible."""
        return (Assumption("M_hat stays uniformly positive definite (a_d_hat_box can keep it so)", "eq. (60)"),)
