"""The torque that the estimated dynamics asks for."""

from __future__ import annotations

from typing import ClassVar, final

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.certificate import Certificate
from dmframe.port import Port


@final
class CertaintyEquivalence(AbstractBlock):
    r"""Takes the estimates for the truth: inverse dynamics along the reference acceleration.

    .. math::

        \tau_d = Y_d \hat a_d   \tag{1}

    Parameters
    ----------
    None. A torque law of your own, any block with an output tau_d, can stand in its place.

    References
    ----------
    [WangTAC2020]_ eqs. (54), (59).
    """

    inputs: ClassVar[tuple[Port, ...]] = (Port("Y_d", "n p", "N m"), Port("a_d_hat", "p", ""))
    outputs: ClassVar[tuple[Port, ...]] = (Port("tau_d", "n", "N m"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"tau_d": u.Y_d @ u.a_d_hat})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """Nothing is stored."""
        return Certificate()
