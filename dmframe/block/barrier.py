"""Reference velocities that respect position limits, and the bound by which the position may exceed them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import casadi as ca

from dmframe.block.condition import SX
from dmframe.block.fields import Expressions
from dmframe.block.naming import operation


@operation
def soft_min(first: SX, second: SX, width: SX) -> SX:
    """Smooth minimum, element by element; it is less than the minimum where the arguments differ by a few widths."""
    return (first + second - _rounded(first - second, width)) / 2


@operation
def soft_between(wish: SX, lower: SX, upper: SX, width: SX) -> SX:
    """Smooth saturation of `wish` between `lower` and `upper`; the value always lies between them."""
    return (lower + upper + _rounded(wish - lower, width) - _rounded(wish - upper, width)) / 2


def _rounded(x: SX, width: SX) -> SX:
    """Smooth absolute value. The radicand is at least 1, so the root is differentiable everywhere."""
    return width * ca.sqrt(1 + (x / width) ** 2)


@final
@dataclass(frozen=True, eq=False)
class Barrier(Expressions):
    r"""A reference velocity that respects position limits, and the tube in which the position stays.

    With the distances :math:`h = \mathrm{upper} - q` and :math:`h_2 = q - \mathrm{lower}`, the reference is

    .. math::

        \dot q_r = \mathrm{soft\_between}(\mathrm{wish}, -\mathrm{soft\_min}(v, a h_2), \mathrm{soft\_min}(v, a h))

    so that :math:`-a h_2 \le \dot q_r \le a h` and :math:`|\dot q_r| \le v` for every `wish`. With
    :math:`s = \dot q - \dot q_r`

    .. math:: \dot h \ge -a h - |s| \quad\Rightarrow\quad h(t) \ge e^{-a t} h(0) - |s|_{L_2} / \sqrt{2 a}

    V dissipates :math:`|s|^2`, so V(0) bounds its integral :math:`|s|_{L_2}^2`.

    Parameters
    ----------
    position
        q, a column of states of the plant.
    wish
        The reference velocity without limits.
    lower, upper
        Positions at which the reference stops: columns of parameters.
    speed, rate, width
        v, a and the width of the smooth minima: columns or scalars of parameters, > 0.
    margin
        Distance of `lower` and `upper` from the true limits, inwards.
    """

    position: SX
    wish: SX
    lower: SX
    upper: SX
    speed: SX
    rate: SX
    width: SX
    margin: SX = 0

    @property
    def reference(self) -> SX:
        """The reference velocity."""
        upper = soft_min(self.speed, self.rate * (self.upper - self.position), self.width)
        lower = -soft_min(self.speed, self.rate * (self.position - self.lower), self.width)
        return soft_between(self.wish, lower, upper, self.width)
