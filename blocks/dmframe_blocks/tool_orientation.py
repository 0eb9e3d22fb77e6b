"""The tool's orientation, and the Jacobian of its whole pose."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, final

import casadi as ca

from dmframe.block import AbstractBlock, Certificate, Equations, Input, Output, Positive, Scalar, Signals


@final
class ToolOrientation(AbstractBlock):
    r"""Adds the tool's orientation to a task of its position.

    .. math::

        R &= R_{tool}(q)   \tag{1} \\
        J_{pose} &= \begin{bmatrix} \hat J \\ \mathrm{lever}\, J_{turn}(q) \end{bmatrix}   \tag{2}

    with :math:`R_{tool}(q)` the tool's orientation, whose angular velocity in the base's axes is
    :math:`\omega = J_{turn}(q) \dot q`. No length is in either, so that both are known exactly where lengths are
    uncertain; the position's :math:`\hat J` may be that of adapted kinematics.

    Parameters
    ----------
    lever : scalar, m/rad, > 0
        How much a turn weighs beside a shift: an error of a small angle counts as one of the position of
        sqrt(2) lever times that angle. Larger closes the error of the orientation faster.

    Notes
    -----
    Not for: a tool whose orientation on the last link is uncertain, or a wrist that comes near a singular pose.

    References
    ----------
    [Siciliano2009]_ section 3.1, the geometric Jacobian.
    """

    uses_robot = True
    inputs = (Input("q", "n", "rad"), Input("J_hat", "m n", "m/rad"))
    outputs = (
        Output("R", "3 3"),
        Output("J_pose", "r n", "m/rad", full_rank=True),
        Output("lever", "", "m/rad"),
    )

    lever: Scalar = Positive("", "m/rad")

    def sizes(self, robot: Any) -> Mapping[str, int]:
        """The rows of a pose's Jacobian: those of the position, and three."""
        return {"r": robot.m + 3}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        J_pose = ca.vertcat(u.J_hat, p.lever * p.robot.angular_jacobian(u.q))
        return Equations(outputs={"R": p.robot.rotation(u.q), "J_pose": J_pose, "lever": p.lever})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """Nothing is stored."""
        return Certificate()
