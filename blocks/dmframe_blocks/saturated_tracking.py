"""Reference for tracking in the task space with saturated feedback and known kinematics."""

from __future__ import annotations

from typing import final

from dmframe.block import (
    AbstractBlock,
    Certificate,
    Consumed,
    Diagonal,
    Equations,
    Input,
    Output,
    Positive,
    Potential,
    Scalar,
    Signals,
    Square,
    named,
    soft_clip,
    solve_spd,
)


@final
class SaturatedTracking(AbstractBlock):
    r"""Joint reference velocity for tracking a tool path, with a feedback that is bounded for large errors.

    .. math::

        \dot q_r &= \hat J^+ \dot x_d - \gamma \hat J^\top \mathrm{pull} + (I - \hat J^+ \hat J)\, \dot q_{null}, \quad
                    \hat J^+ = \hat J^\top (\hat J \hat J^\top)^{-1}           \tag{1}

    with :math:`\Delta x = x - x_d` and, for each coordinate, the force of a saturating spring:

    .. math::

        \mathrm{pull} &= \Delta x / \sqrt{1 + (\Delta x / \mathrm{width})^2}   \tag{2}

    Each element is smaller than its width, so that the feedback velocity is at most
    :math:`\gamma |\hat J| |\mathrm{width}|` for any error. With :math:`b = \hat J^\top \mathrm{pull}` and
    :math:`s = \dot q - \dot q_r` it forms a cascade with the servo level. Its cross term is :math:`|s|^2 / \gamma`.
    The storage function is the energy of the springs, which is radially unbounded:

    .. math::

        S &= (\mathrm{width}^2)^\top (\sqrt{1 + (\Delta x / \mathrm{width})^2} - 1) \\
        \dot S &= - \tfrac34 \gamma |b|^2 - \gamma |\tfrac12 b - s / \gamma|^2 + \tfrac1\gamma |s|^2 \tag{3}

    Parameters
    ----------
    gamma : scalar, rad^2/(m^2 s), > 0
        Task gain near the path, as in `known_tracking`.
    width : diagonal (m,), m, > 0
        Error of a coordinate at which the force is 0.71 of the linear one. It is also the limit of the force.

    Notes
    -----
    Not for: strict velocity limits, since the velocity along the path and that of the servo's inverse are added: see
    `safe_reference`.

    References
    ----------
    [WangTAC2020]_ for the reference; [TakegakiArimoto1981]_ for a spring as energy.
    """

    inputs = (
        Input("x", "m", "m"),
        Input("x_d", "m", "m"),
        Input("dx_d", "m", "m/s", derivative_of="x_d"),
        Input("J_hat", "m n", "m/rad"),
        Input("dq_null", "n", "rad/s", optional=True),
    )
    outputs = (Output("dq_r", "n", "rad/s"),)
    truth = (Input("dq", "n", "rad/s"),)

    gamma: Scalar = Positive("", "rad^2/(m^2 s)")
    width: Diagonal = Positive("m", "m")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        forward = solve_spd(u.J_hat @ u.J_hat.T, u.dx_d - u.J_hat @ u.dq_null)
        force = named("pull", soft_clip(u.x - u.x_d, p.width))
        return Equations(outputs={"dq_r": u.J_hat.T @ (forward - p.gamma * force) + u.dq_null})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(3); dx is J dq."""
        s = named("s", truth.dq - self.equations(u, x, p).outputs["dq_r"])
        x_err = u.x - u.x_d
        b = u.J_hat.T @ named("pull", soft_clip(x_err, p.width))
        return Certificate(
            storage=(Potential(x_err, p.width),),
            dissipation=(
                Square(b, 3 * p.gamma / 4),
                Square(b / 2 - s / p.gamma, p.gamma),
            ),
            consumes=Consumed(s, 1 / p.gamma),
        )
