"""The Jacobian of kinematics that are adapted while the robot moves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal, final

import casadi as ca

from dmframe.adaptation import DeadZone, ErrorLeak, Estimate, Leak, adaptation
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.certificate import SX, Certificate
from dmframe.parameter import Around, Ball, Box, Diagonal, Interval, Positive, Real, Scalar
from dmframe.port import Port, State


@final
class AdaptiveKinematics(AbstractBlock):
    r"""Estimates link and tool offsets from the tool's measured position, and gives the Jacobian with them.

    .. math::

        \hat J &= J(q, \hat a_k)                                             \tag{1} \\
        \dot{\hat a}_k &= \Gamma_k Y_k(q, \dot q)^\top e_k                   \tag{2}

    with :math:`J(q) \psi = Y_k(q, \psi) a_k`, so that :math:`\hat J \dot q - \dot x = Y_k \tilde a_k` with
    :math:`\tilde a_k = \hat a_k - a_k`. The error :math:`e_k` comes from the reference generator, and so does the
    weight :math:`\alpha` of the task in the Lyapunov function:

    .. math::

        S &= \tfrac12 \alpha |\tilde a_k|^2_{\Gamma_k^{-1}}                  \tag{3} \\
        \dot S &= \alpha\, e_k^\top (\hat J \dot q - \dot x)                 \tag{4}

    Parameters
    ----------
    Gamma_k : diagonal (h,), > 0
        Adaptation gain. Larger adapts faster and passes more noise of the measured position.
    adapt : all, links or tool
        Which translations are adapted: those of the joints, that of the tool, or both. The others are known.
    start_error : (h,), m
        Error of the estimate at the start.
    a_k_hat_box : [lower, upper]
        Interval onto which the estimate is projected, to keep the Jacobian's rank.
    a_k_hat_ball : [centre, radius]
        Instead of the box, the ball onto which it is projected; with a list for the radius, an ellipsoid.
    leak, error_leak, dead_zone : 1/s; 1/(m s); (m,), m; > 0
        Robust laws, each absent unless given: a pull back to the start; one in proportion to e_k; no adaptation
        while e_k is below this width. See `dmframe.adaptation`.

    Notes
    -----
    Not for: a robot whose tool is not seen, since x must be measured rather than computed.

    References
    ----------
    [WangTAC2020]_ eqs. (4), (13), (22).
    """

    uses_robot: ClassVar[bool] = True
    inputs: ClassVar[tuple[Port, ...]] = (
        Port("q", "n", "rad"),
        Port("dq", "n", "rad/s"),
        Port("e_k", "m", "m"),
    )
    outputs: ClassVar[tuple[Port, ...]] = (Port("J_hat", "m n", "m/rad", full_rank=True),)
    states: ClassVar[tuple[State, ...]] = (
        State("a_k_hat", "h", "m", box="a_k_hat_box", ball="a_k_hat_ball", gain="Gamma_k"),
    )
    truth: ClassVar[tuple[Port, ...]] = (Port("dx", "m", "m/s"), Port("task_weight"))

    Gamma_k: Diagonal = Positive("h", "rad^2/(m^2 s)")
    adapt: Literal["all", "links", "tool"] = "all"
    start_error: Diagonal = Real("h", "m", default=0.0)
    a_k_hat_box: Box = Interval("h", "m")
    a_k_hat_ball: Ball = Around("h", "m")
    leak: Scalar | None = Leak()
    error_leak: Scalar | None = ErrorLeak("1/(m s)")
    dead_zone: Diagonal | None = DeadZone("m", "m")

    def sizes(self, robot: Any) -> Mapping[str, int]:
        """h: three a translation."""
        return {"h": {"all": robot.k, "links": robot.k - 3, "tool": 3}[self.adapt]}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        a_k = self._with(p.robot, x.a_k_hat)
        Y_k = ca.jacobian(p.robot.jacobian(u.q, a_k) @ u.dq, x.a_k_hat)
        law = adaptation(p)
        gradient = p.Gamma_k * (Y_k.T @ law.drive(u.e_k))
        return Equations(
            outputs={"J_hat": p.robot.jacobian(u.q, a_k)},
            rates={"a_k_hat": law.rate(gradient, x.a_k_hat, self._start(p), u.e_k)},
        )

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """The true translations, wrong by `start_error`."""
        return {"a_k_hat": self._start(p)}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(3) and (4)."""
        law, alpha = adaptation(p), truth.task_weight
        a_k = Estimate(
            "a_k_hat - a_k",
            "a_k_hat - a_k_hat(0)",
            x.a_k_hat,
            self._adapted(p.robot.a_k),
            self._start(p),
            alpha / p.Gamma_k,
        )
        dx_err = self.equations(u, x, p).outputs["J_hat"] @ u.dq - truth.dx
        robust = law.terms([a_k], u.e_k, "e_k") + law.idle(u.e_k, -alpha * dx_err, "(J_hat - J) dq")
        return Certificate(
            storage=(a_k.storage,),
            dissipation=robust.dissipation,
            excess=robust.excess,
            supply=alpha * ca.dot(u.e_k, dx_err),
            task=True,
        )

    def _start(self, p: Signals) -> SX:
        """The true translations, wrong by `start_error`."""
        return self._adapted(p.robot.a_k) + p.start_error

    def _adapted(self, a_k: SX) -> SX:
        """The part of all kinematic parameters that is adapted."""
        links = a_k.numel() - 3
        return {"all": a_k, "links": a_k[:links], "tool": a_k[links:]}[self.adapt]

    def _with(self, robot: Any, estimate: SX) -> SX:
        """All kinematic parameters, the adapted ones replaced by their estimates."""
        links = robot.k - 3
        known = robot.a_k
        parts = {"all": [estimate], "links": [estimate, known[links:]], "tool": [known[:links], estimate]}
        return ca.vertcat(*parts[self.adapt])
