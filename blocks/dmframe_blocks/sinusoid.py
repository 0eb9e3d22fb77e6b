"""Sinusoidal joint path."""

from __future__ import annotations

from typing import final

import casadi as ca

from dmframe.block import TIME, AbstractBlock, Diagonal, Equations, Output, Real, Side, Signals, Vector


@final
class Sinusoid(AbstractBlock):
    r"""Sinusoidal motion of each joint.

    .. math::

        q_d = c + a \sin(\omega t + \varphi)   \tag{1}

    element by element, with :math:`c = \mathrm{center}`, :math:`a = \mathrm{amplitude}`, :math:`\omega = \mathrm{rate}`
    and :math:`\varphi = \mathrm{phase}`.

    Parameters
    ----------
    center : (n,), rad
        Centre of the oscillation.
    amplitude : (n,), rad
        Amplitude of the oscillation.
    rate : (n,), rad/s
        Angular frequency. Incommensurate frequencies excite more dynamic parameters.
    phase : (n,), rad
        Initial phase.
    """

    side = Side.SOURCE
    inputs = (TIME,)
    outputs = (Output("q_d", "n", "rad"),)

    center: Vector = Real("n", "rad", spread=False)
    amplitude: Diagonal = Real("n", "rad")
    rate: Diagonal = Real("n", "rad/s")
    phase: Diagonal = Real("n", "rad", default=0.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"q_d": p.center + p.amplitude * ca.sin(p.rate * u.t + p.phase)})
