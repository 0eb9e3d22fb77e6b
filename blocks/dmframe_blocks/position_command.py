"""Commands joint positions instead of velocities."""

from __future__ import annotations

from typing import final

from dmframe.block import AbstractBlock, Access, Certificate, Equations, Input, Output, Signals


@final
class PositionCommand(AbstractBlock):
    r"""Sends the integral of the velocity command, for a robot that takes joint positions.

    .. math::

        q_t = q_c   \tag{1}

    On a clock it is held from one sample to the next: the robot gets a staircase. `position_interface` is its
    counterpart in the plant.

    Parameters
    ----------
    None.

    Notes
    -----
    :math:`q_c(t_k)` is what the controller has commanded so far, the sum of its own held velocities times the period;
    it needs no measurement, though here it is read from the servo, which is the same number.

    References
    ----------
    [WangTAC2020]_, the servos, which take :math:`\dot q_c` and its integral.
    """

    inputs = (Input("q_c", "n", "rad"),)
    outputs = (Output("q_t", "n", "rad", Access.COMMANDED),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"q_t": u.q_c})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """Nothing is stored."""
        return Certificate()
