"""Gradient adaptation of a manipulator's dynamic parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

import casadi as ca

from dmframe.adaptation import DeadZone, ErrorLeak, Estimate, Leak, adaptation, start_of
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.certificate import SX, Certificate
from dmframe.linalg import metric, times
from dmframe.parameter import Around, Ball, Box, Diagonal, Gain, Interval, PositiveDefinite, Real, Scalar
from dmframe.port import Port, State


@final
class DynamicCompensator(AbstractBlock):
    r"""Adaptive dynamic compensation along the reference motion.

    .. math::

        \tau_{dc}      &= Y_d \hat a_d + \tau_{task}          \tag{1} \\
        \dot{\hat a}_d &= -\Gamma (Y_d^\top \sigma + Y_f^\top e_f)   \tag{2}

    The term in :math:`e_f` makes it composite, with a `filtered_regressor` in the graph, and is zero without. With
    :math:`\tilde a_d = \hat a_d - a_d`, it is lossless from :math:`\sigma` to :math:`-Y_d \tilde a_d`:

    .. math::

        S &= \tfrac12 |\tilde a_d|^2_{\Gamma^{-1}}   \tag{3} \\
        \dot S &= -\sigma^\top Y_d \tilde a_d - e_f^\top Y_f \tilde a_d   \tag{4}

    Parameters
    ----------
    Gamma : (p, p), positive definite, or its diagonal
        Adaptation gain. Larger adapts faster, passes more velocity noise, and lowers the sampling period up to which
        the loop is stable.
    a_d_hat : (p,)
        The estimate at the start; left out, the robot's nominal model if `regressor` hands it out, else zero.
    a_d_hat_box : [lower, upper]
        Interval onto which the estimate is projected.
    a_d_hat_ball : [centre, radius]
        Instead of the box, the ball onto which it is projected; with a list for the radius, an ellipsoid.
    leak, error_leak, dead_zone : 1/s; 1/rad; (n,), rad/s; > 0
        Robust laws, each absent unless given: a pull back to the start; one in proportion to sigma; no adaptation
        while sigma is below this width. See `dmframe.adaptation`.

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
        Port("Y_f", "n p", "N m", optional=True),
        Port("e_f", "n", "rad/s", optional=True),
    )
    outputs: ClassVar[tuple[Port, ...]] = (Port("tau_dc", "n", "N m"), Port("a_d_hat", "p", ""))
    states: ClassVar[tuple[State, ...]] = (
        State("a_d_hat", "p", "", box="a_d_hat_box", ball="a_d_hat_ball", gain="Gamma"),
    )
    truth: ClassVar[tuple[Port, ...]] = (Port("a_d", "p", ""),)

    Gamma: Gain = PositiveDefinite("p")
    a_d_hat: Diagonal | None = Real("p", default=None)
    a_d_hat_box: Box = Interval("p")
    a_d_hat_ball: Ball = Around("p")
    leak: Scalar | None = Leak()
    error_leak: Scalar | None = ErrorLeak("1/rad")
    dead_zone: Diagonal | None = DeadZone("n", "rad/s")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        law = adaptation(p)
        gradient = -times(p.Gamma, u.Y_d.T @ law.drive(u.sigma) + u.Y_f.T @ u.e_f)
        return Equations(
            outputs={"tau_dc": u.Y_d @ x.a_d_hat + u.tau_task, "a_d_hat": x.a_d_hat},
            rates={"a_d_hat": law.rate(gradient, x.a_d_hat, start_of("a_d_hat", p, u.a_d_nominal), u.sigma)},
        )

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """The nominal model, or zero."""
        return {"a_d_hat": u.a_d_nominal}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(3) and (4)."""
        law, effect = adaptation(p), u.Y_d @ (x.a_d_hat - truth.a_d)
        a_d = Estimate(x.a_d_hat, truth.a_d, start_of("a_d_hat", p, u.a_d_nominal), metric(p.Gamma))
        robust = law.terms([a_d], u.sigma) + law.idle(u.sigma, effect)
        return Certificate(
            storage=(a_d.storage,),
            dissipation=robust.dissipation,
            excess=robust.excess,
            supply=-ca.dot(u.sigma, effect) - ca.dot(u.e_f, u.Y_f @ (x.a_d_hat - truth.a_d)),
        )
