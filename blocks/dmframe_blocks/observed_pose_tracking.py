"""Reference for tracking position and orientation of the tool with uncertain lengths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import casadi as ca

from dmframe.block import (
    SX,
    AbstractBlock,
    Certificate,
    Condition,
    Consumed,
    Equations,
    Inequality,
    Input,
    Output,
    Positive,
    Scalar,
    Signals,
    Square,
    named,
    solve_spd,
)
from dmframe_blocks._quaternions import LESS_THAN_HALF_A_TURN, apart, left, right, turn_from


@final
class ObservedPoseTracking(AbstractBlock):
    r"""Joint reference velocity for position and orientation, with the observed instead of the measured position.

    Only the position rows are uncertain. An orientation does not depend on lengths, so R and the lower rows of
    :math:`J_{pose}` are known; the upper rows are :math:`\hat J`, as in the observer. With E and G of
    :math:`p_d` as in `pose_tracking`,

    .. math::

        R_d &= E G^\top / |p_d|^2, \quad \omega_d = 2 E \dot p_d / |p_d|^2, \quad
        R_{apart} = |\operatorname{vec}(R - R_d)|^2                                                \tag{1} \\
        \dot q_r &= J_{pose}^+ v_d - \gamma J_{pose}^\top e_o + (I - J_{pose}^+ J_{pose})\, \dot q_{null}, \quad
        J_{pose}^+ = J_{pose}^\top (J_{pose} J_{pose}^\top)^{-1}                                   \tag{2} \\
        e_k &= \Delta x - \Delta x_o, \quad \Delta x = x - x_d, \quad \Delta x_o = x_o - x         \tag{3}

    with :math:`v_d = (\dot x_d, \mathrm{lever}\, \omega_d)`, :math:`e_o = (x_o - x_d, \mathrm{lever}\, e_R)` and
    :math:`e_R` the vector of :math:`R R_d^\top - R_d R^\top`.

    With :math:`a = \hat J^\top \Delta x_o`, :math:`b = J_{pose}^\top (\Delta x, \mathrm{lever}\, e_R)` and
    :math:`s = \dot q - \dot q_r` it forms a cascade with the servo level, like `observed_tracking`:

    .. math::

        S &= \tfrac12 |\Delta x|^2 + \tfrac12 \mathrm{lever}^2 |\operatorname{vec}(R - R_d)|^2   \tag{4} \\
        \dot S &= -(\tfrac34 \beta |a|^2 + \gamma a^\top b + \tfrac34 \gamma |b|^2)
                  - \gamma |\tfrac12 b - s/\gamma|^2 + \tfrac34 \beta |a|^2 + \tfrac1\gamma |s|^2
                  - \Delta x^\top (\hat J \dot q - \dot x)   \tag{5}

    Parameters
    ----------
    gamma : scalar, rad^2/(m^2 s), > 0
        Task gain; the proof requires :math:`\gamma < 9 \beta/4`, with :math:`\beta` of the observer.

    Notes
    -----
    Convergence is almost global, as in `pose_tracking`. `task_weight` is the weight of the task level in V.

    References
    ----------
    [WangTAC2020]_ eqs. (30), (31), for a pose; [Siciliano2009]_ section 3.7.3 for errors of an orientation.
    """

    inputs = (
        Input("x", "m", "m"),
        Input("x_o", "m", "m"),
        Input("x_d", "m", "m"),
        Input("dx_d", "m", "m/s", derivative_of="x_d"),
        Input("R", "3 3"),
        Input("p_d", "4"),
        Input("dp_d", "4", "1/s", derivative_of="p_d"),
        Input("J_hat", "m n", "m/rad"),
        Input("J_pose", "r n", "m/rad"),
        Input("lever", "", "m/rad"),
        Input("dq_null", "n", "rad/s", optional=True),
    )
    outputs = (
        Output("dq_r", "n", "rad/s"),
        Output("e_k", "m", "m"),
        Output("R_d", "3 3"),
        Output("R_apart"),
    )
    truth = (
        Input("dq", "n", "rad/s"),
        Input("dx", "m", "m/s"),
        Input("beta", "", "rad^2/(m^2 s)"),
    )

    gamma: Scalar = Positive("", "rad^2/(m^2 s)")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1), (2) and (3)."""
        E, G, length = named("E", left(u.p_d)), named("G", right(u.p_d)), ca.sumsqr(u.p_d)
        R_d, omega_d = E @ G.T / length, named("omega_d", 2 * (E @ u.dp_d) / length)
        e_o = named("e_o", ca.vertcat(u.x_o - u.x_d, u.lever * self._turn(u, R_d)))
        v_d = ca.vertcat(u.dx_d, u.lever * omega_d)
        forward = solve_spd(u.J_pose @ u.J_pose.T, v_d - u.J_pose @ u.dq_null)
        dq_r = u.J_pose.T @ (forward - p.gamma * e_o) + u.dq_null
        e_k = (u.x - u.x_d) - (u.x_o - u.x)
        return Equations(outputs={"dq_r": dq_r, "e_k": e_k, "R_d": R_d, "R_apart": apart(u.R, R_d)})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(4) and (5); the upper rows of J_pose are J_hat."""
        outputs, x_err = self.equations(u, x, p).outputs, u.x - u.x_d
        R_d, s = outputs["R_d"], named("s", truth.dq - outputs["dq_r"])
        e_R = self._turn(u, R_d)
        a, b = u.J_hat.T @ (u.x_o - u.x), u.J_pose.T @ ca.vertcat(x_err, u.lever * e_R)
        one = ca.DM.eye(a.numel())
        Q = ca.blockcat([[3 * truth.beta / 4 * one, p.gamma / 2 * one], [p.gamma / 2 * one, 3 * p.gamma / 4 * one]])
        exchange = 3 * truth.beta / 4 * ca.dot(a, a) - ca.dot(x_err, u.J_hat @ truth.dq - truth.dx)
        return Certificate(
            storage=(Square(x_err), Square(ca.vec(u.R - R_d), u.lever**2)),
            dissipation=(
                Square(ca.vertcat(a, b), Q),
                Square(b / 2 - s / p.gamma, p.gamma),
            ),
            supply=exchange,
            consumes=Consumed(s, 1 / p.gamma),
            truth={"task_weight": 1},
            errors=(Square(e_R),),
        )

    def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        """The observer must be fast enough for the task, and the orientation error less than half a turn."""
        fast_enough = Inequality("beta > 4 gamma/9", truth.beta - 4 * p.gamma / 9, "eqs. (26), (31)")
        return fast_enough, LESS_THAN_HALF_A_TURN

    def _turn(self, u: Signals, R_d: SX) -> SX:
        return named("e_R", turn_from(u.R, R_d))
