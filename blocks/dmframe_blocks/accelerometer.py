"""A sensor of joint accelerations."""

from __future__ import annotations

from typing import final

from dmframe.block import AbstractBlock, Access, Certificate, Equations, Input, Output, Side, Signals


@final
class Accelerometer(AbstractBlock):
    r"""Outputs the joint accelerations, which industrial robots usually do not provide.

    .. math::

        \ddot q_m = \ddot q   \tag{1}

    Parameters
    ----------
    None.

    Notes
    -----
    Not for: accelerations differentiated from a velocity; the proof does not include their noise and delay.

    References
    ----------
    [WangTAC2020]_ Section IV: the torque-based framework needs accelerations.
    """

    side = Side.PLANT
    inputs = (Input("ddq", "n", "rad/s^2"),)
    outputs = (Output("ddq_m", "n", "rad/s^2", Access.MEASURED),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"ddq_m": u.ddq})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """No storage."""
        return Certificate()
