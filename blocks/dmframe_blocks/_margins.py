"""Gain of a discrete-time integrator: from stated margins of gain and delay, and with limited acceleration."""

from __future__ import annotations

from math import pi, sin
from typing import Protocol

import casadi as ca

from dmframe.block import SX, Signals, named, operation
from dmframe_blocks._identified_delay import Delayed, chosen, longest


class Margined(Delayed, Protocol):
    """A block whose gain follows from margins."""

    @property
    def delay_margin(self) -> int:
        """Margin of the delay in samples."""


def gain_at_limit(block: Margined, u: Signals) -> SX | float:
    """T Lambda at the limit of stability, 2 sin(pi/(4 m + 2)), with the delay m of the margin.

    With an identified delay this delay is added to the margin; the longest one, until it is identified.
    """
    bounds = [2 * sin(pi / (4 * (block.delay_margin + d) + 2)) for d in range(longest(block) + 1)]
    if block.delay_up_to is None:
        return bounds[0]
    return named("bound", ca.if_else(u.identified, chosen(bounds, u.delay_hat), bounds[-1]))


@operation
def braked(error: SX, gain: SX) -> SX:
    """Share of the gain with which an error, divided by the largest acceleration, is corrected without overshoot.

    With the whole gain L the correction of the error e has the velocity w = L e, and while the error decreases by it,
    de/dt = -w, the acceleration is L^2 e. It is largest at e = 1/L^2, where it is 1. Beyond, w = sqrt(2 e - 1/L^2) has
    the acceleration w dw/de = 1, and joins w = L e with the same slope. Returned is w/(L e), 1 for small errors.
    """
    far = ca.fmax(ca.fabs(error) * gain * gain, 1)
    return ca.sqrt(2 * far - 1) / far
