"""Reference for tracking in joint space."""

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
)


@final
class JointTracking(AbstractBlock):
    r"""Joint reference velocity for tracking a joint path.

    .. math::

        \dot q_r &= \dot q_d - \bar\alpha (q - q_d)   \tag{1}

    With :math:`\Delta q = q - q_d` and :math:`s = \dot q - \dot q_r` it forms a cascade with the servo level. Its cross
    term is :math:`|s|^2 / \bar\alpha`:

    .. math::

        S &= \tfrac12 |\Delta q|^2   \tag{2} \\
        \dot S &= - \tfrac34 \bar\alpha |\Delta q|^2 - \bar\alpha |\tfrac12 \Delta q - s / \bar\alpha|^2
                  + \tfrac1{\bar\alpha} |s|^2   \tag{3}

    Parameters
    ----------
    alpha_bar : scalar, 1/s, > 0
        Desired decay rate of the error. A larger rate requires a faster servo and a shorter sampling period.

    References
    ----------
    [WangTAC2020]_ eq. (45).
    """

    renamed: ClassVar[Mapping[str, str]] = {"alpha": "alpha_bar", "dq_ref": "dq_r"}
    inputs = (
        Input("q", "n", "rad"),
        Input("q_d", "n", "rad"),
        Input("dq_d", "n", "rad/s", derivative_of="q_d"),
    )
    outputs = (Output("dq_r", "n", "rad/s"),)
    truth = (Input("dq", "n", "rad/s"),)

    alpha_bar: Scalar = Positive("", "1/s")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"dq_r": u.dq_d - p.alpha_bar * (u.q - u.q_d)})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(2) and (3)."""
        q_err = u.q - u.q_d
        s = named("s", truth.dq - self.equations(u, x, p).outputs["dq_r"])
        return Certificate(
            storage=(Square(q_err),),
            dissipation=(
                Square(q_err, 3 * p.alpha_bar / 4),
                Square(q_err / 2 - s / p.alpha_bar, p.alpha_bar),
            ),
            consumes=Consumed(s, 1 / p.alpha_bar),
        )
