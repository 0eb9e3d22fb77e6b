"""Gain of a discrete-time integrator: from stated margins of gain and delay, and with limited acceleration."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi, sin
from typing import Any, Protocol

import casadi as ca

from dmframe.block import SX, Signals, named, operation
from dmframe_blocks._identified_delay import Delayed, check_delay, chosen, longest


class Margined(Delayed, Protocol):
    """A block whose gain follows from margins."""

    @property
    def gain_margin(self) -> float | None:
        """Margin of the gain; None if the gain itself is given."""

    @property
    def delay_margin(self) -> int:
        """Margin of the delay in samples."""


def check_gain(block: Margined, gains: Sequence[str], expected: str) -> None:
    """Raise ValueError unless a block has one of its gains, with margins that fit it, and one delay."""
    given = [name for name in gains if getattr(block, name) is not None]
    if len(given) != 1:
        raise ValueError(f"expected one of {expected}, found {' and '.join(given) or 'none'}")
    if block.gain_margin is not None and block.gain_margin < 1:
        raise ValueError(f"expected a gain_margin of 1 or more, found {block.gain_margin}")
    if block.gain_margin is None and block.delay_margin != _default(block):
        raise ValueError("expected no delay_margin without gain_margin, which computes the gain; leave it out")
    check_delay(block)


def _default(block: Any) -> int:
    found: int = type(block).model_fields["delay_margin"].default
    return found


def ends_of_sample(block: Delayed, u: Signals, path: Sequence[SX], *, names: tuple[str, str]) -> tuple[SX, SX]:
    """The path where the sample begins and where it ends in which the command acts.

    Parameters
    ----------
    path
        The path now, and after 1, 2, ... samples.
    names
        Of the two points with an identified delay, for printed formulas.
    """
    if block.delay_up_to is None:
        return path[block.delay], path[block.delay + 1]
    now, goal = chosen(path[:-1], u.delay_hat), chosen(path[1:], u.delay_hat)
    return named(names[0], now), named(names[1], goal)


def gain_at_limit(block: Margined, u: Signals) -> SX | float:
    """T Lambda at the limit of stability, 2 sin(pi/(4 m + 2)), with the delay m of the margin.

    With an identified delay this delay is added to the margin; the longest one, until it is identified.
    """
    bounds = [2 * sin(pi / (4 * (block.delay_margin + d) + 2)) for d in range(longest(block) + 1)]
    if block.delay_up_to is None:
        return bounds[0]
    return named("bound", ca.if_else(u.identified, chosen(bounds, u.delay_hat), bounds[-1]))


def remark_of(block: Margined) -> str:
    """That the gain follows from margins; empty for a given gain."""
    if block.gain_margin is None:
        return ""
    samples = block.delay_margin + longest(block)
    also = f" with the longest delay, {samples} samples," if longest(block) else ""
    gain = 2 * sin(pi / (4 * samples + 2)) / block.gain_margin
    return (
        f"Lambda is derived at each sampling period T from gain_margin {block.gain_margin:g} and delay_margin "
        f"{block.delay_margin}:{also} T Lambda = {gain:.3g}. A longer period has a smaller Lambda, so that the loop "
        "may stay stable at all of them; Lambda=... instead of gain_margin analyses one gain"
    )


@operation
def braked(error: SX, gain: SX) -> SX:
    """Share of the gain with which an error size, divided by the largest acceleration, is corrected without overshoot.

    With the whole gain L the correction of the error e has the velocity w = L e, and while the error decreases by it,
    de/dt = -w, the acceleration is L^2 e. It is largest at e = 1/L^2, where it is 1. Beyond, w = sqrt(2 e - 1/L^2) has
    the acceleration w dw/de = 1, and joins w = L e with the same slope. Returned is w/(L e), 1 for small errors.
    """
    far = ca.fmax(error * gain * gain, 1)
    return ca.sqrt(2 * far - 1) / far
