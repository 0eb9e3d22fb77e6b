"""Reference for tracking position and orientation of the tool with known kinematics."""

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
class PoseTracking(AbstractBlock):
    r"""Joint reference velocity for tracking a path of tool positions and orientations.

    The desired orientation is a quaternion :math:`p_d` of any length but zero. From it follow the 3 x 4 matrices E and
    G, with which :math:`R_d` is identically orthogonal:

    .. math::

        R_d &= E G^\top / |p_d|^2, \quad \omega_d = 2 E \dot p_d / |p_d|^2, \quad
        R_{apart} = |\operatorname{vec}(R - R_d)|^2                                                \tag{1} \\
        \dot q_r &= J_{pose}^+ v_d - \gamma J_{pose}^\top e + (I - J_{pose}^+ J_{pose})\, \dot q_{null}, \quad
        J_{pose}^+ = J_{pose}^\top (J_{pose} J_{pose}^\top)^{-1}                                   \tag{2}

    with :math:`v_d = (\dot x_d, \mathrm{lever}\, \omega_d)` and :math:`e = (x - x_d, \mathrm{lever}\, e_R)`.
    :math:`e_R` is the vector of :math:`R R_d^\top - R_d R^\top`: the axis of the rotation from :math:`R_d` to R, times
    twice the sine of its angle.

    With :math:`b = J_{pose}^\top e` and :math:`s = \dot q - \dot q_r` it forms a cascade with the servo level. Its
    cross term is :math:`|s|^2 / \gamma`, as for `known_tracking`:

    .. math::

        S &= \tfrac12 |x - x_d|^2 + \tfrac12 \mathrm{lever}^2 |\operatorname{vec}(R - R_d)|^2   \tag{3} \\
        \dot S &= - \tfrac34 \gamma |b|^2 - \gamma |\tfrac12 b - s / \gamma|^2 + \tfrac1\gamma |s|^2 \tag{4}

    Parameters
    ----------
    gamma : scalar, rad^2/(m^2 s), > 0
        Task gain. A larger gain reduces the error faster; it requires a faster servo and a shorter sampling period.

    Notes
    -----
    Convergence is almost global. Let D be the output R_apart, 8 times the square of the sine of half the angle between
    R and :math:`R_d`; then :math:`|e_R|^2 = D (8 - D)/4`. If :math:`e_R` converges to zero, the tool converges to its
    desired orientation, or to half a turn from it, where D is 8. V contains half of :math:`\mathrm{lever}^2 D` and does
    not increase, so the second case is excluded for :math:`V(0) < 4\, \mathrm{lever}^2`. For larger V(0) it is an
    unstable equilibrium: D has its maximum there.

    Not for: a singular Jacobian; uncertain kinematics, see `observed_pose_tracking`.

    References
    ----------
    [WangTAC2020]_ eq. (30), for a pose; [Siciliano2009]_ section 3.7.3 for errors of an orientation.
    """

    inputs = (
        Input("x", "m", "m"),
        Input("x_d", "m", "m"),
        Input("dx_d", "m", "m/s", derivative_of="x_d"),
        Input("R", "3 3"),
        Input("p_d", "4"),
        Input("dp_d", "4", "1/s", derivative_of="p_d"),
        Input("J_pose", "r n", "m/rad"),
        Input("lever", "", "m/rad"),
        Input("dq_null", "n", "rad/s", optional=True),
    )
    outputs = (
        Output("dq_r", "n", "rad/s"),
        Output("R_d", "3 3"),
        Output("R_apart"),
    )
    truth = (Input("dq", "n", "rad/s"),)

    gamma: Scalar = Positive("", "rad^2/(m^2 s)")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        E, G, length = named("E", left(u.p_d)), named("G", right(u.p_d)), ca.sumsqr(u.p_d)
        R_d, omega_d = E @ G.T / length, named("omega_d", 2 * (E @ u.dp_d) / length)
        v_d, e_R = ca.vertcat(u.dx_d, u.lever * omega_d), named("e_R", turn_from(u.R, R_d))
        forward = solve_spd(u.J_pose @ u.J_pose.T, v_d - u.J_pose @ u.dq_null)
        dq_r = u.J_pose.T @ (forward - p.gamma * _error(u, e_R)) + u.dq_null
        return Equations(outputs={"dq_r": dq_r, "R_d": R_d, "R_apart": apart(u.R, R_d)})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(3) and (4)."""
        outputs = self.equations(u, x, p).outputs
        R_d, s = outputs["R_d"], named("s", truth.dq - outputs["dq_r"])
        e_R = named("e_R", turn_from(u.R, R_d))
        b = u.J_pose.T @ _error(u, e_R)
        return Certificate(
            storage=(Square(u.x - u.x_d), Square(ca.vec(u.R - R_d), u.lever**2)),
            dissipation=(
                Square(b, 3 * p.gamma / 4),
                Square(b / 2 - s / p.gamma, p.gamma),
            ),
            consumes=Consumed(s, 1 / p.gamma),
            errors=(Square(e_R),),
        )

    def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        """The orientation error is less than half a turn, where e_R vanishes too."""
        return (LESS_THAN_HALF_A_TURN,)


def _error(u: Signals, e_R: SX) -> SX:
    return named("e", ca.vertcat(u.x - u.x_d, u.lever * e_R))
