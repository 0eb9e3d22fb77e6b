"""Reference for tracking at the joints."""

from __future__ import annotations

from typing import ClassVar, final

import casadi as ca

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.certificate import Certificate, Square
from dmframe.parameter import Positive, Scalar
from dmframe.port import Port


@final
class JointTracking(AbstractBlock):
    r"""Joint reference that leads the joints onto their path.

    .. math::

        \dot q_{ref} &= \dot q_d - \bar\alpha (q - q_d)   \tag{1} \\
        \sigma       &= \dot q - \dot q_{ref}             \tag{2}

    With :math:`\Delta q = q - q_d` it is a cascade on the servo level, of which it consumes
    :math:`|\sigma|^2 / \bar\alpha`:

    .. math::

        S &= \tfrac12 |\Delta q|^2   \tag{3} \\
        \dot S &= - \tfrac34 \bar\alpha |\Delta q|^2 - \bar\alpha |\tfrac12 \Delta q - \sigma / \bar\alpha|^2
                  + \tfrac1{\bar\alpha} |\sigma|^2   \tag{4}

    Parameters
    ----------
    alpha : scalar, 1/s, > 0
        Rate at which the error is asked to decay. Larger is faster and asks more of the servo and the sampling period.

    References
    ----------
    [WangTAC2020]_ eq. (45).
    """

    inputs: ClassVar[tuple[Port, ...]] = (
        Port("q", "n", "rad"),
        Port("dq", "n", "rad/s"),
        Port("q_d", "n", "rad"),
        Port("dq_d", "n", "rad/s", derivative_of="q_d"),
    )
    outputs: ClassVar[tuple[Port, ...]] = (Port("dq_ref", "n", "rad/s"), Port("sigma", "n", "rad/s"))

    alpha: Scalar = Positive("", "1/s")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        dq_ref = u.dq_d - p.alpha * (u.q - u.q_d)
        return Equations(outputs={"dq_ref": dq_ref, "sigma": u.dq - dq_ref})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(3) and (4)."""
        q_err = u.q - u.q_d
        sigma = self.equations(u, x, p).outputs["sigma"]
        return Certificate(
            storage=(Square("q - q_d", q_err, ca.SX(1)),),
            dissipation=(
                Square("q - q_d", q_err, 3 * p.alpha / 4),
                Square("(q - q_d)/2 - sigma/alpha", q_err / 2 - sigma / p.alpha, p.alpha),
            ),
            supply=ca.dot(sigma, sigma) / p.alpha,
            consumes=1 / p.alpha,
        )
