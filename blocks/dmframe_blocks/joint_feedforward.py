"""Reference of the joints that follows the path's velocity and does not look at the error."""

from __future__ import annotations

from typing import final

from dmframe.block import AbstractBlock, Certificate, Equations, Input, Output, Signals


@final
class JointFeedforward(AbstractBlock):
    r"""The path's own velocity as the joint reference, so that the inverse's :math:`q_r` is the path itself.

    .. math::

        \dot q_r = \dot q_d   \tag{1}

    and :math:`q_r = q_d` if the robot starts on its path, since an inverse's :math:`q_r` starts at :math:`q(0)`.

    It stores nothing and consumes nothing: V is the servo level's alone, and what V says of :math:`q - q_r` is all that
    is known of the error. Over a PI servo V holds :math:`q - q_r` (up to the constant with which the servo's integrator
    starts) and dissipates :math:`\sigma` alone: the velocity error goes to zero, the position error is bounded
    and stops anywhere. Over a PID servo with a tied velocity V dissipates :math:`q - q_r` too, which then goes to zero.

    Parameters
    ----------
    None.

    Notes
    -----
    Not for: work. It is here to show what is lost without the term in the error; see `joint_tracking`.

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
        """Of (1) nothing is stored: the error q - q_d stands in no term of its own."""
        return Certificate()
