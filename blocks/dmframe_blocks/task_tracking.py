"""Reference for tracking in the task space, kinematics known."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, final

import casadi as ca

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.certificate import Assumption, Certificate, Condition, Square
from dmframe.linalg import solve_spd
from dmframe.parameter import Positive, Scalar
from dmframe.port import Port


@final
class TaskTracking(AbstractBlock):
    r"""Joint reference that leads the tool onto its path.

    .. math::

        \dot q_{ref} &= J^+ \dot x_d - \gamma J^\top (x - x_d) + (I - J^+ J)\, z, \quad
                        J^+ = J^\top (J J^\top)^{-1}                                \tag{1} \\
        \sigma       &= \dot q - \dot q_{ref}                                       \tag{2}

    A redundant robot may move by :math:`z` as far as its tool does not notice, :math:`J (I - J^+ J) = 0`: see
    `null_space_posture`. Nobody needs to drive z.

    With :math:`\Delta x = x - x_d` and :math:`b = J^\top \Delta x` it is a cascade on the servo level, of which it
    consumes :math:`|\sigma|^2 / \gamma`:

    .. math::

        S &= \tfrac12 |\Delta x|^2   \tag{3} \\
        \dot S &= - \tfrac34 \gamma |b|^2 - \gamma |\tfrac12 b - \sigma / \gamma|^2 + \tfrac1\gamma |\sigma|^2 \tag{4}

    Parameters
    ----------
    gamma : scalar, rad^2/(m^2 s), > 0
        Task gain. Larger closes the error faster and asks more of the servo and of the sampling period.

    Notes
    -----
    Not for: a singular Jacobian, or kinematics that are uncertain.

    References
    ----------
    [WangTAC2020]_ eq. (30), with J for its estimate, as in Section V.
    """

    inputs: ClassVar[tuple[Port, ...]] = (
        Port("x", "m", "m"),
        Port("x_d", "m", "m"),
        Port("dx_d", "m", "m/s", derivative_of="x_d"),
        Port("J_hat", "m n", "m/rad"),
        Port("dq", "n", "rad/s"),
        Port("z", "n", "rad/s", optional=True),
    )
    outputs: ClassVar[tuple[Port, ...]] = (Port("dq_ref", "n", "rad/s"), Port("sigma", "n", "rad/s"))

    gamma: Scalar = Positive("", "rad^2/(m^2 s)")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        forward = solve_spd(u.J_hat @ u.J_hat.T, u.dx_d - u.J_hat @ u.z)
        dq_ref = u.J_hat.T @ (forward - p.gamma * (u.x - u.x_d)) + u.z
        return Equations(outputs={"dq_ref": dq_ref, "sigma": u.dq - dq_ref})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(3) and (4); of the supply, dx is J dq."""
        x_err = u.x - u.x_d
        sigma = self.equations(u, x, p).outputs["sigma"]
        b = u.J_hat.T @ x_err
        return Certificate(
            storage=(Square("x - x_d", x_err, ca.SX(1)),),
            dissipation=(
                Square("J'(x - x_d)", b, 3 * p.gamma / 4),
                Square("J'(x - x_d)/2 - sigma/gamma", b / 2 - sigma / p.gamma, p.gamma),
            ),
            supply=ca.dot(sigma, sigma) / p.gamma,
            consumes=1 / p.gamma,
        )

    def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        """(1) needs the inverse of J J'."""
        return (Assumption("the Jacobian keeps full row rank along the motion, uniformly", "eq. (30)"),)
