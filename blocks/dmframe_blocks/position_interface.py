"""Joint position interface of a robot."""

from __future__ import annotations

from typing import final

from dmframe.block import AbstractBlock, Certificate, Equations, Input, Output, Side, Signals


@final
class PositionInterface(AbstractBlock):
    r"""Passes the commanded position to the servo as a staircase, without interpolation.

    .. math::

        q_{step} = q_t - q_c   \tag{1}

    with :math:`q_c` the integral of the velocity command, so that the servo's position error is :math:`q - q_t`. In
    continuous time :math:`q_{step}` is zero, so that proofs hold for both kinds of command. On a clock the position
    lags by half a period on average; the velocity command still acts as feed-forward.

    Parameters
    ----------
    None.

    Notes
    -----
    Not for: an interface that interpolates linearly between commanded positions; it is equivalent to the velocity
    command with a delay of one period, or without delay if the controller sends the position one period ahead. Nor for
    a servo without velocity feed-forward, which differs from eqs. (6), (7).

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
        """No storage."""
        return Certificate()
