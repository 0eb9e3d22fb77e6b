"""Joint position command from a velocity command."""

from __future__ import annotations

from typing import final

from dmframe.block import AbstractBlock, Access, Certificate, Equations, Input, Output, Signals


@final
class PositionCommand(AbstractBlock):
    r"""Sends the integral of the velocity command, for a robot with a joint position interface.

    .. math::

        q_t = q_c   \tag{1}

    On a clock it is held between samples, so that the robot receives a staircase. `position_interface` is the
    corresponding block of the plant.

    Parameters
    ----------
    None.

    Notes
    -----
    :math:`q_c(t_k)` is the sum of the commanded velocities times the period, so it requires no measurement. Here it is
    read from the servo, which computes the same number.

    References
    ----------
    [WangTAC2020]_, the servos, whose inputs are :math:`\dot q_c` and its integral.
    """

    inputs = (Input("q_c", "n", "rad"),)
    outputs = (Output("q_t", "n", "rad", Access.COMMANDED),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"q_t": u.q_c})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """No storage."""
        return Certificate()
