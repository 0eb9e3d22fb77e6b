"""Manufacturer's PI velocity servo."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

from dmframe.block import (
    SX,
    AbstractBlock,
    Access,
    Certificate,
    Diagonal,
    Equations,
    Input,
    Output,
    Positive,
    Side,
    Signals,
    State,
)


@final
class PiServo(AbstractBlock):
    r"""Closed PI servo for joint velocities: it can be neither read nor changed.

    .. math::

        \dot i &= \dot q - \dot q_c                                \tag{1} \\
        u      &= -K_P (\dot q - \dot q_c) - K_I (i - q_{step})    \tag{2}

    The servo integrates the velocity command, :math:`q_c = q(0) + \int \dot q_c`, and reports the result, usually
    called the target position. :math:`q_{step}` is zero unless positions are commanded: see `position_interface`.
    Initially the integrator balances gravity: :math:`i(0) = -g(q)/(K K_I)`.

    Parameters
    ----------
    K_P : diagonal (n,), V s/rad, > 0
        Gain on the velocity error.
    K_I : diagonal (n,), V/rad, > 0
        Integral gain.

    References
    ----------
    [WangTAC2020]_ eq. (6).
    """

    side = Side.PLANT
    inputs = (
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
        Input("dq_c", "n", "rad/s"),
        Input("q_step", "n", "rad", optional=True),
    )
    outputs = (
        Output("q_c", "n", "rad", Access.MEASURED),
        Output("u", "n", "V"),
        Output("i", "n", "rad"),
        Output("K_P", "n", "V s/rad"),
        Output("K_I", "n", "V/rad"),
    )
    states = (State("q_c", "n", "rad"), State("i", "n", "rad"))
    truth = (Input("g", "n", "N m"), Input("K", "n", "N m/V"))

    K_P: Diagonal = Positive("n", "V s/rad")
    K_I: Diagonal = Positive("n", "V/rad")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        voltage = -p.K_P * (u.dq - u.dq_c) - p.K_I * (x.i - u.q_step)
        return Equations(
            outputs={"q_c": x.q_c, "u": voltage, "i": x.i, "K_P": p.K_P, "K_I": p.K_I},
            rates={"q_c": u.dq_c, "i": u.dq - u.dq_c},
        )

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """At rest, with the integrator balancing gravity."""
        return {"q_c": u.q, "i": -truth.g / (truth.K * p.K_I)}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """No storage: that of the servo is in the block that inverts it. The truth is the command as it arrives."""
        return Certificate(truth={"dq_s": u.dq_c})
