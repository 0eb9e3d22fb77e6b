"""A maker's interface for joint positions."""

from __future__ import annotations

from typing import final

from dmframe.block import AbstractBlock, Certificate, Equations, Input, Output, Side, Signals


@final
class PositionInterface(AbstractBlock):
    r"""Hands the commanded position to the servo as it comes, as a staircase, without interpolation.

    .. math::

        q_{step} = q_t - q_c   \tag{1}

    with :math:`q_c` the integral of the velocity command, so that the servo's position error is :math:`q - q_t`. In
    continuous time :math:`q_{step}` is zero, and what is proved is proved for both kinds of command. On a clock the
    position lags by half a period on average; the velocity still comes along, as a feed-forward.

    Parameters
    ----------
    None.

    Notes
    -----
    Not for: a maker who interpolates linearly from one commanded position to the next; that is the velocity command
    with a delay of one period, or without one if the controller sends the position one period ahead. Nor for one who
    takes positions and leaves the velocity error out; its servo is not that of eqs. (6), (7).

    References
    ----------
    [WangTAC2020]_, the servos.
    """

    side = Side.PLANT
    inputs = (Input("q_t", "n", "rad"), Input("q_c", "n", "rad"))
    outputs = (Output("q_step", "n", "rad"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"q_step": u.q_t - u.q_c})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """Nothing is stored."""
        return Certificate()
