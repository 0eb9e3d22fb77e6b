"""The maker's PI velocity servo."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.certificate import SX, Certificate
from dmframe.parameter import Diagonal, Positive
from dmframe.port import Access, Port, Side, State


@final
class PiServo(AbstractBlock):
    r"""PI servo of the joint velocities, closed: nothing of it can be read or changed.

    .. math::

        \dot i &= \dot q - \dot q_c                                \tag{1} \\
        u      &= -K_P (\dot q - \dot q_c) - K_I (i - q_{step})    \tag{2}

    The servo integrates the velocity command by itself, :math:`q_c = q(0) + \int \dot q_c`, and reports the result;
    makers call it the target position. :math:`q_{step}` is zero unless positions are commanded: see
    `position_interface`. At the start the integrator holds the robot against gravity:
    :math:`i(0) = -g(q)/(K K_I)`.

    Parameters
    ----------
    K_P : diagonal (n,), V s/rad, > 0
        Stiffness against velocity errors.
    K_I : diagonal (n,), V/rad, > 0
        Integral gain.

    References
    ----------
    [WangTAC2020]_ eq. (6).
    """

    side: ClassVar[Side] = Side.PLANT
    inputs: ClassVar[tuple[Port, ...]] = (
        Port("q", "n", "rad"),
        Port("dq", "n", "rad/s"),
        Port("dq_c", "n", "rad/s"),
        Port("q_step", "n", "rad", optional=True),
    )
    outputs: ClassVar[tuple[Port, ...]] = (
        Port("q_c", "n", "rad", Access.MEASURED),
        Port("u", "n", "V"),
        Port("i", "n", "rad"),
        Port("K_P", "n", "V s/rad"),
        Port("K_I", "n", "V/rad"),
    )
    states: ClassVar[tuple[State, ...]] = (State("q_c", "n", "rad"), State("i", "n", "rad"))
    truth: ClassVar[tuple[Port, ...]] = (Port("g", "n", "N m"), Port("K", "n", "N m/V"))

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
        """At rest, holding gravity."""
        return {"q_c": u.q, "i": -truth.g / (truth.K * p.K_I)}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """Its energy stands with the block that inverts it; the command that it takes, with what came between."""
        return Certificate(truth={"dq_s": u.dq_c})
