r"""A third-order linearly implicit (Rosenbrock) method for stiff plants, and its linear systems.

With :math:`A` instead of the rate's Jacobian and :math:`d` instead of its derivative by time, a step of length h is

.. math::

    k_i &= h f\big(t + \alpha_i h,\; x + \textstyle\sum_{j<i} \alpha_{ij} k_j\big)
          + h A \textstyle\sum_{j \le i} \gamma_{ij} k_j + \gamma_i h^2 d, \tag{1} \\
    x^+ &= x + \textstyle\sum_i b_i k_i. \tag{2}

The order does not depend on :math:`A` and :math:`d` (a W-method); the stability for stiff plants does. The variables
:math:`u_i = \sum_j \gamma_{ij} k_j` remove the products with :math:`A`, [Hairer1996]_ (IV.7.25):

.. math::

    (I - h \gamma A)\, u_i = \gamma \Big( h f\big(t + \alpha_i h,\; x + \textstyle\sum_{j<i} a_{ij} u_j\big)
        + \textstyle\sum_{j<i} c_{ij} u_j + \gamma_i h^2 d \Big), \qquad
    x^+ = x + \textstyle\sum_i m_i u_i. \tag{3}
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Final, final

Row = tuple[Fraction, ...]


@final
@dataclass(frozen=True)
class Rosenbrock:
    r"""The coefficients of a method, exactly as they were published.

    Parameters
    ----------
    gamma
        The diagonal of :math:`\gamma_{ij}`.
    points, couplings
        The rows of :math:`\alpha_{ij}` and of :math:`\gamma_{ij}`, left of the diagonal.
    weights
        :math:`b_i`.
    """

    gamma: Fraction
    points: tuple[Row, ...]
    couplings: tuple[Row, ...]
    weights: Row

    @property
    def stages(self) -> int:
        """Number of linear systems per step."""
        return len(self.weights)

    @cached_property
    def full(self) -> tuple[Row, ...]:
        r""":math:`\gamma_{ij}` with its diagonal."""
        zeros = self.stages * (Fraction(0),)
        return tuple((*row, self.gamma, *zeros[i + 1 :]) for i, row in enumerate(self.couplings))

    @property
    def nodes(self) -> Row:
        r""":math:`\alpha_i`, the times within a step at which the rate is evaluated."""
        return tuple(Fraction(sum(row)) for row in self.points)

    @property
    def drifts(self) -> Row:
        r""":math:`\gamma_i`, the coefficient of the time derivative in each stage."""
        return tuple(Fraction(sum(row)) for row in self.full)

    @cached_property
    def inverse(self) -> tuple[Row, ...]:
        r"""Inverse of :math:`\gamma_{ij}`, with which (3) follows from (1)."""
        rows = list[Row]()
        for i, row in enumerate(self.full):
            left = [
                -sum((row[k] * rows[k][j] for k in range(j, i)), Fraction(0)) / self.gamma for j in range(i)
            ]  # fmt: skip
            rows.append((*left, 1 / self.gamma, *[Fraction(0)] * (self.stages - i - 1)))
        return tuple(rows)

    @property
    def a(self) -> tuple[Row, ...]:
        r""":math:`a_{ij}` of (3)."""
        return tuple(self._times((*row, *[Fraction(0)] * (self.stages - i)))[:i] for i, row in enumerate(self.points))

    @property
    def c(self) -> tuple[Row, ...]:
        r""":math:`c_{ij}` of (3)."""
        return tuple(tuple(-value for value in row[:i]) for i, row in enumerate(self.inverse))

    @property
    def m(self) -> Row:
        """:math:`m_i` of (3)."""
        return self._times(self.weights)

    def _times(self, row: Sequence[Fraction]) -> Row:
        columns = range(self.stages)
        return tuple(sum((row[k] * self.inverse[k][j] for k in columns), Fraction(0)) for j in columns)


def _numbers(*texts: str) -> Row:
    return tuple(Fraction(text) for text in texts)


ROS34PW2: Final = Rosenbrock(
    gamma=Fraction("4.3586652150845900e-01"),
    points=(
        (),
        _numbers("8.7173304301691801e-01"),
        _numbers("8.4457060015369423e-01", "-1.1299064236484185e-01"),
        _numbers("0", "0", "1"),
    ),
    couplings=(
        (),
        _numbers("-8.7173304301691801e-01"),
        _numbers("-9.0338057013044082e-01", "5.4180672388095326e-02"),
        _numbers("2.4212380706095346e-01", "-1.2232505839045147e+00", "5.4526025533510214e-01"),
    ),
    weights=_numbers(
        "2.4212380706095346e-01", "-1.2232505839045147e+00", "1.5452602553351020e+00", "4.3586652150845900e-01"
    ),
)
"""Four stages, third order for any A, L-stable with the exact Jacobian, stiffly accurate [RangAngermann2005]_."""
