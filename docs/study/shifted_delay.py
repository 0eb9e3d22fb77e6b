"""A delay that differs from the identified one, for ``identified_delay.py``."""

from __future__ import annotations

from typing import final

import casadi as ca

from dmframe.block import AbstractBlock, Equations, Input, Output, Real, Scalar, Signals


@final
class ShiftedDelay(AbstractBlock):
    """The delay of a `delay_probe`, longer by `shift` samples, at least 0."""

    inputs = (Input("delay_probed"),)
    outputs = (Output("delay_hat"),)

    shift: Scalar = Real(default=0.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The sum."""
        return Equations(outputs={"delay_hat": ca.fmax(0, u.delay_probed + p.shift)})
