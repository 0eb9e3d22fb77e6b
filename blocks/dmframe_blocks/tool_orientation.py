"""Orientation of the tool, and the Jacobian of its pose."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, final

import casadi as ca

from dmframe.block import AbstractBlock, Certificate, Equations, Input, Output, Positive, Scalar, Signals


@final
class ToolOrientation(AbstractBlock):
    r"""Adds the tool's orientation to a position task.

    .. math::

        R &= R_{tool}(q)   \tag{1} \\
        J_{pose} &= \begin{bmatrix} \hat J \\ \mathrm{lever}\, J_{turn}(q) \end{bmatrix}   \tag{2}

    with :math:`R_{tool}(q)` the tool's orientation, whose angular velocity in the base frame is
    :math:`\omega = J_{turn}(q) \dot q`. Neither depends on lengths, so both are known exactly even if lengths are
    uncertain; :math:`\hat J` of the position may be that of adaptive kinematics.

    Parameters
    ----------
    lever : scalar, m/rad, > 0
        Weight of orientation errors relative to position errors: a small angle is equivalent to a position error of
        :math:`\sqrt 2` lever times that angle. A larger value reduces the orientation error faster.

    Notes
    -----
    Not for: a tool with an uncertain orientation on the last link, or a wrist near a singular pose.

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
        """The number of rows of the pose Jacobian: those of the position, plus three."""
        return {"r": robot.m + 3}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        J_pose = ca.vertcat(u.J_hat, p.lever * p.robot.angular_jacobian(u.q))
        return Equations(outputs={"R": p.robot.rotation(u.q), "J_pose": J_pose, "lever": p.lever})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """No storage."""
        return Certificate()
