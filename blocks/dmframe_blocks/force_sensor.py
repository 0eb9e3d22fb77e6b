"""A force sensor at the tool, with noise and an offset."""

from __future__ import annotations

from typing import final

from dmframe.block import AbstractBlock, Access, Diagonal, Equations, Input, NonNegative, Output, Real, Side, Signals


@final
class ForceSensor(AbstractBlock):
    r"""Hands out the force on the tool with an offset, and with noise that each sample draws anew.

    .. math::

        f_m = f_{ext} + \mathrm{offset} + \mathrm{noise}\, \eta   \tag{1}

    Controllers then read :math:`f_m` in place of :math:`f_{ext}`, without any wire. A real sensor also feels the weight
    of what hangs on it, which is taken away before; what is left of that stands in the offset.

    Parameters
    ----------
    offset : diagonal (m,), N
        What the sensor shows without a force.
    noise : diagonal (m,), N, >= 0
        Standard deviation of the noise.

    Notes
    -----
    With a noise the block runs on a clock alone. Nothing is proved of it: what the sensor shows too much, nobody
    cancels.

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
