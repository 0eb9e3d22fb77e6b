"""Manufacturer's PID position servo."""

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
class PidServo(AbstractBlock):
    r"""Closed PID servo for joint positions: it can be neither read nor changed.

    .. math::

        \dot i &= q - q_c - q_{step}                                               \tag{1} \\
        u      &= -K_D (\dot q - \dot q_c) - K_P (q - q_c - q_{step}) - K_I i     \tag{2}

    The servo integrates the velocity command, :math:`q_c = q(0) + \int \dot q_c`, and reports the result, usually
    called the target position. :math:`q_{step}` is zero unless positions are commanded: see `position_interface`.
    Initially the integrator balances gravity: :math:`i(0) = -g(q)/(K K_I)`.

    Parameters
    ----------
    K_D : diagonal (n,), V s/rad, > 0
        Gain on the velocity error.
    K_P : diagonal (n,), V/rad, > 0
        Gain on the position error.
    K_I : diagonal (n,), V/(rad s), > 0
        Integral gain.

    References
    ----------
    [WangTAC2020]_ eq. (7).
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
        Output("i", "n", "rad s"),
        Output("K_D", "n", "V s/rad"),
        Output("K_P", "n", "V/rad"),
        Output("K_I", "n", "V/(rad s)"),
    )
    states = (State("q_c", "n", "rad"), State("i", "n", "rad s"))
    truth = (Input("g", "n", "N m"), Input("K", "n", "N m/V"))

    K_D: Diagonal = Positive("n", "V s/rad")
    K_P: Diagonal = Positive("n", "V/rad")
    K_I: Diagonal = Positive("n", "V/(rad s)")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        voltage = -p.K_D * (u.dq - u.dq_c) - p.K_P * (u.q - x.q_c - u.q_step) - p.K_I * x.i
        return Equations(
            outputs={"q_c": x.q_c, "u": voltage, "i": x.i, "K_D": p.K_D, "K_P": p.K_P, "K_I": p.K_I},
            rates={"q_c": u.dq_c, "i": u.q - x.q_c - u.q_step},
        )

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """At rest, with the integrator balancing gravity."""
        return {"q_c": u.q, "i": -truth.g / (truth.K * p.K_I)}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """No storage: that of the servo is in the block that inverts it. The truth is the command as it arrives."""
        return Certificate(truth={"dq_s": u.dq_c})
