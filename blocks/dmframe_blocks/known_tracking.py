"""Reference for tracking in the task space with known kinematics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

from dmframe.block import (
    AbstractBlock,
    Certificate,
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


@final
class KnownTracking(AbstractBlock):
    r"""Joint reference velocity for tracking a tool path.

    .. math::

        \dot q_r &= \hat J^+ \dot x_d - \gamma \hat J^\top (x - x_d) + (I - \hat J^+ \hat J)\, \dot q_{null}, \quad
                    \hat J^+ = \hat J^\top (\hat J \hat J^\top)^{-1}           \tag{1}

    :math:`\dot q_{null}` moves a redundant robot without moving its tool, since
    :math:`\hat J (I - \hat J^+ \hat J) = 0`: see `null_space_posture`. The input is optional.

    With :math:`\Delta x = x - x_d`, :math:`b = \hat J^\top \Delta x` and :math:`s = \dot q - \dot q_r` it forms a
    cascade with the servo level. Its cross term is :math:`|s|^2 / \gamma`:

    .. math::

        S &= \tfrac12 |\Delta x|^2   \tag{2} \\
        \dot S &= - \tfrac34 \gamma |b|^2 - \gamma |\tfrac12 b - s / \gamma|^2 + \tfrac1\gamma |s|^2 \tag{3}

    Parameters
    ----------
    gamma : scalar, rad^2/(m^2 s), > 0
        Task gain. A larger gain reduces the error faster; it requires a faster servo and a shorter sampling period.

    Notes
    -----
    Not for: a singular Jacobian, or uncertain kinematics.

    References
    ----------
    [WangTAC2020]_ eq. (30), with J for its estimate, as in Section V.
    """

    renamed: ClassVar[Mapping[str, str]] = {"z": "dq_null", "dq_ref": "dq_r"}
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

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        forward = solve_spd(u.J_hat @ u.J_hat.T, u.dx_d - u.J_hat @ u.dq_null)
        return Equations(outputs={"dq_r": u.J_hat.T @ (forward - p.gamma * (u.x - u.x_d)) + u.dq_null})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(2) and (3); dx is J dq."""
        x_err = u.x - u.x_d
        s = named("s", truth.dq - self.equations(u, x, p).outputs["dq_r"])
        b = u.J_hat.T @ x_err
        return Certificate(
            storage=(Square(x_err),),
            dissipation=(
                Square(b, 3 * p.gamma / 4),
                Square(b / 2 - s / p.gamma, p.gamma),
            ),
            consumes=Consumed(s, 1 / p.gamma),
        )
