"""A maker's interface for joint torques."""

from __future__ import annotations

from typing import final

from dmframe.block import AbstractBlock, Certificate, Equations, Input, Output, Side, Signals


@final
class TorqueInterface(AbstractBlock):
    r"""Turns the commanded torque into the motors' voltage, at once and exactly: the architecture is open.

    .. math::

        u = K^{-1} \tau_c   \tag{1}

    Most industrial robots have none; it stands in the graphs that the closed servo is compared with.

    Parameters
    ----------
    None.

    Notes
    -----
    Not for: a drive whose current loop is slow, or whose torque ripples.

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
        """Nothing is stored."""
        return Certificate()
