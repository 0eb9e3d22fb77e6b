"""Joint torque interface of a robot."""

from __future__ import annotations

from typing import final

from dmframe.block import AbstractBlock, Certificate, Equations, Input, Output, Side, Signals


@final
class TorqueInterface(AbstractBlock):
    r"""Converts the commanded torque to motor voltage without error or delay: an open architecture.

    .. math::

        u = K^{-1} \tau_c   \tag{1}

    Most industrial robots have no such interface. Graphs for comparison with a closed servo use it.

    Parameters
    ----------
    None.

    Notes
    -----
    Not for: a drive with a slow current loop or torque ripple.

    References
    ----------
    [SlotineLi1991]_ Section 9.1.
    """

    side = Side.PLANT
    inputs = (Input("tau_c", "n", "N m"), Input("K", "n", "N m/V"))
    outputs = (Output("u", "n", "V"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"u": u.tau_c / u.K})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """No storage."""
        return Certificate()
