"""Certainty-equivalence torque of estimated dynamics."""

from __future__ import annotations

from typing import final

from dmframe.block import AbstractBlock, Certificate, Equations, Input, Output, Signals


@final
class CertaintyEquivalence(AbstractBlock):
    r"""Inverse dynamics along the reference acceleration with estimated parameters (certainty equivalence).

    .. math::

        \tau_d = Y_d \hat a_d   \tag{1}

    Parameters
    ----------
    None. Any block with an output tau_d can replace it.

    References
    ----------
    [WangTAC2020]_ eqs. (54), (59).
    """

    inputs = (Input("Y_d", "n p", "N m"), Input("a_d_hat", "p", ""))
    outputs = (Output("tau_d", "n", "N m"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"tau_d": u.Y_d @ u.a_d_hat})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """No storage."""
        return Certificate()
