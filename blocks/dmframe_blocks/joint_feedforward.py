"""Joint reference velocity without feedback of the tracking error."""

from __future__ import annotations

from typing import final

from dmframe.block import AbstractBlock, Certificate, Equations, Input, Output, Signals


@final
class JointFeedforward(AbstractBlock):
    r"""Uses the desired velocity as the joint reference, so that :math:`q_r` of the inverse is the path itself.

    .. math::

        \dot q_r = \dot q_d   \tag{1}

    and :math:`q_r = q_d` if the robot starts on its path, since :math:`q_r` of an inverse starts at :math:`q(0)`.

    The block has no storage and no cross term: V is that of the servo level, so conclusions about :math:`q - q_r` are
    all that is proved about the error. With a PI servo V contains :math:`q - q_r` (up to the constant initial value of
    the servo's integrator) and dissipates :math:`\sigma` only. The velocity error then converges to zero; the position
    error is bounded but need not converge to zero. With a PID servo and ``tie: velocity`` V dissipates
    :math:`q - q_r` too, which then converges to zero.

    Parameters
    ----------
    None.

    Notes
    -----
    Not for: practical use. It demonstrates the loss of accuracy without feedback of the error; see `joint_tracking`.

    References
    ----------
    [WangTAC2020]_ Section IV-A, its last remark.
    """

    inputs = (
        Input("q_d", "n", "rad"),
        Input("dq_d", "n", "rad/s", derivative_of="q_d"),
    )
    outputs = (Output("dq_r", "n", "rad/s"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"dq_r": u.dq_d})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """No storage: the error q - q_d has no separate term in V."""
        return Certificate()
