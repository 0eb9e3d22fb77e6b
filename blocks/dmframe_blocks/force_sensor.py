"""Force sensor at the tool, with noise and offset."""

from __future__ import annotations

from typing import final

from dmframe.block import AbstractBlock, Access, Diagonal, Equations, Input, NonNegative, Output, Real, Side, Signals


@final
class ForceSensor(AbstractBlock):
    r"""Outputs the force on the tool with an offset, and with noise drawn at each sample.

    .. math::

        f_m = f_{ext} + \mathrm{offset} + \mathrm{noise}\, \eta   \tag{1}

    Controllers then read :math:`f_m` instead of :math:`f_{ext}`, without a wire. A real sensor also measures the weight
    of the tool; the model assumes that this is compensated, and the offset represents the remaining error.

    Parameters
    ----------
    offset : diagonal (m,), N
        Reading without a force.
    noise : diagonal (m,), N, >= 0
        Standard deviation of the noise.

    Notes
    -----
    With noise the block runs on a clock only. It has no proof, since the measurement error is not compensated.

    References
    ----------
    [Siciliano2009]_ Section 5.4.1.
    """

    side = Side.PLANT
    inputs = (Input("f_ext", "m", "N"), Input("eta", "m", drawn="normal"))
    outputs = (Output("f_m", "m", "N", Access.MEASURED, instead_of="f_ext"),)

    offset: Diagonal = Real("m", "N", default=0.0)
    noise: Diagonal = NonNegative("m", "N", default=0.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations({"f_m": u.f_ext + p.offset + p.noise * u.eta})
