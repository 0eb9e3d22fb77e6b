"""The Jacobian of known kinematics."""

from __future__ import annotations

from typing import final

from dmframe.block import AbstractBlock, Certificate, Equations, Input, Output, Signals


@final
class Kinematics(AbstractBlock):
    r"""The task Jacobian of the robot's own geometry, and the task velocity that follows from it.

    .. math::

        \hat J &= J(q)                       \tag{1} \\
        \dot x &= J(q) \dot q                \tag{2}

    with :math:`J(q)` the derivative of :math:`f(q)`, the tool's position.

    The task velocity is computed, not measured. Derivatives of references, such as the reference acceleration, use it.

    Parameters
    ----------
    None; the geometry is the robot's.

    Notes
    -----
    Not for: a tool or links whose lengths are uncertain.

    References
    ----------
    [WangTAC2020]_ eqs. (1), (2).
    """

    uses_robot = True
    inputs = (Input("q", "n", "rad"), Input("dq", "n", "rad/s"), Input("x", "m", "m"))
    outputs = (
        Output("J_hat", "m n", "m/rad", full_rank=True),
        Output("dx", "m", "m/s", derivative_of="x"),
    )

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        J = p.robot.jacobian(u.q)
        return Equations(outputs={"J_hat": J, "dx": J @ u.dq})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """No storage."""
        return Certificate()
