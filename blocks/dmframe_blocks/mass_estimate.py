"""Estimated mass matrix."""

from __future__ import annotations

from typing import final

from dmframe.block import AbstractBlock, Certificate, Equations, Input, Output, Signals
from dmframe.robot.parameters import DynamicParameters


@final
class MassEstimate(AbstractBlock):
    r"""The robot's mass matrix with the estimated inertial parameters.

    .. math::

        \hat M = M(q, \hat a_d)   \tag{1}

    Parameters
    ----------
    None.

    References
    ----------
    [WangTAC2020]_ eq. (59).
    """

    uses_robot = True
    inputs = (Input("q", "n", "rad"), Input("a_d_hat", "p", ""))
    outputs = (Output("M_hat", "n n", "N m s^2/rad"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        inertial = DynamicParameters(p.robot.chain).inertial
        return Equations(outputs={"M_hat": p.robot.mass_matrix(u.q, u.a_d_hat[inertial])})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """No storage."""
        return Certificate()
