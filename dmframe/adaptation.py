r"""Laws by which an estimate is adapted, and what each adds to dS/dt; an option of every adapting block.

A block's estimate :math:`\hat\theta` of a constant :math:`\theta` is driven by an error s, through a gradient:

.. math::

    \dot{\hat\theta} = -\Gamma\, \Phi(D_v(s)) - (\lambda + \nu\, |s|) (\hat\theta - \theta_0)

:math:`\Phi` is linear, :math:`\theta_0` where the estimate starts. With all three left out it is the gradient law.

============== ========== ============================================================================================
law            parameter  what it does
============== ========== ============================================================================================
leak           lambda     sigma modification: pulls the estimate back to its start, so that it cannot drift away
error leak     nu         e modification: the same, in proportion to the error: no pull once the error has gone
dead zone      v          :math:`D_v(s) = s - \mathrm{clip}(s, v)`: no adaptation where the error is within the noise
============== ========== ============================================================================================

With :math:`S = \tfrac12 |\tilde\theta|^2_W`, :math:`\tilde\theta = \hat\theta - \theta`, and
:math:`\tilde\theta^\top W \Gamma\, \Phi(s) = s^\top b` (b is what the error of the estimate does to the loop):

.. math::

    \dot S = -s^\top b + \mathrm{clip}(s, v)^\top b - \tfrac12 (\lambda + \nu |s|)
             (|\tilde\theta|^2_W + |\hat\theta - \theta_0|^2_W - |\theta - \theta_0|^2_W)

so a leak dissipates two squares and leaves one that is constant, :math:`\tfrac\lambda2 |\theta - \theta_0|^2_W`: zero
if the start was right. A dead zone leaves a term of either sign, at most :math:`\sum_i v_i |b_i|`. The literature's
sigma is :math:`\Gamma^{-1} \lambda`: as a rate, lambda has one unit for all estimates.

References
----------
[IoannouSun1996]_ chapter 8; [NarendraAnnaswamy1987]_ for the e modification.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

from dmframe.certificate import SX, Bounded, Clipped, Dissipated, NormSquare, Square, dead_zone, norm
from dmframe.parameter import Positive


def Leak() -> Any:
    """The parameter `leak`: a rate, or none."""
    return Positive("", "1/s", default=None)


def ErrorLeak(unit: str = "") -> Any:
    """The parameter `error_leak`: a rate a unit of the error, or none."""
    return Positive("", unit, default=None)


def DeadZone(shape: str, unit: str = "") -> Any:
    """The parameter `dead_zone`: the width, of the error's shape and unit, or none."""
    return Positive(shape, unit, default=None)


@final
@dataclass(frozen=True)
class Terms:
    """What an adaptation adds to its block's certificate."""

    dissipation: tuple[Dissipated, ...] = ()
    excess: tuple[Bounded, ...] = ()

    def __add__(self, other: Terms) -> Terms:
        return Terms(self.dissipation + other.dissipation, self.excess + other.excess)


@final
@dataclass(frozen=True)
class Estimate:
    """One estimate with what its certificate needs.

    Parameters
    ----------
    error, start
        How a reader writes the estimate minus the truth, and minus its start: ``"w - 1/K_star"``, ``"w - w(0)"``.
    value, truth, nominal
        The estimate, what it estimates, and where it starts.
    weight
        W: S is half of |value - truth|_W^2.
    """

    error: str
    start: str
    value: SX
    truth: SX
    nominal: SX
    weight: SX

    @property
    def away(self) -> str:
        """How a reader writes the truth minus the start, from the other two."""
        return " - ".join(name.split(" - ", 1)[1] for name in (self.error, self.start))

    @property
    def storage(self) -> Square:
        """|estimate - truth|^2_W; S is half of it."""
        return Square(self.error, self.value - self.truth, self.weight)


@final
@dataclass(frozen=True)
class Adaptation:
    """The law that a block's parameters choose; None where they do not."""

    leak: SX | None
    error_leak: SX | None
    width: SX | None

    def drive(self, error: SX) -> SX:
        """What the gradient takes for the error: what it has beyond the dead zone."""
        return error if self.width is None else dead_zone(error, self.width)

    def rate(self, gradient: SX, value: SX, nominal: SX, error: SX) -> SX:
        r"""The rate of an estimate.

        Parameters
        ----------
        gradient
            :math:`-\Gamma \Phi(D_v(s))`, of `drive`.
        value, nominal
            The estimate, and where it starts.
        error
            s.
        """
        if self.leak is not None:
            gradient = gradient - self.leak * (value - nominal)
        if self.error_leak is not None:
            gradient = gradient - self.error_leak * norm(error) * (value - nominal)
        return gradient

    def terms(self, estimates: Sequence[Estimate], error: SX, error_of: str) -> Terms:
        """What the leaks of a block's estimates dissipate, and what they leave."""
        found = Terms()
        for estimate in estimates:
            if self.leak is not None:
                found += _leaked(estimate, self.leak)
            if self.error_leak is not None:
                plain = _leaked(estimate, self.error_leak)
                found += Terms(
                    tuple(_by(term, error, error_of) for term in plain.dissipation),
                    tuple(_by(term, error, error_of) for term in plain.excess),
                )
        return found

    def idle(self, error: SX, effect: SX, effect_of: str) -> Terms:
        """What the dead zone leaves of s'b: b, by its name, is what the errors of the block's estimates do."""
        if self.width is None:
            return Terms()
        return Terms(excess=(Clipped(effect_of, error, self.width, effect),))


def adaptation(p: Any) -> Adaptation:
    """The law that the parameters `leak`, `error_leak` and `dead_zone` of a block choose."""
    return Adaptation(
        p.leak if "leak" in p else None,
        p.error_leak if "error_leak" in p else None,
        p.dead_zone if "dead_zone" in p else None,
    )


def _leaked(estimate: Estimate, rate: SX) -> Terms:
    half = estimate.weight * rate / 2
    away = estimate.truth - estimate.nominal
    return Terms(
        (
            Square(estimate.error, estimate.value - estimate.truth, half),
            Square(estimate.start, estimate.value - estimate.nominal, half),
        ),
        (Square(estimate.away, away, half),),
    )


def _by(term: Dissipated | Bounded, error: SX, error_of: str) -> NormSquare:
    assert isinstance(term, Square)
    return NormSquare(term.of, term.vector, term.weight, error, error_of)


__all__ = ["Adaptation", "DeadZone", "ErrorLeak", "Estimate", "Leak", "Terms", "adaptation"]
