r"""Laws by which an estimate is adapted, and what each adds to dS/dt; options of every `dmframe.block.AdaptingBlock`.

A block's estimate :math:`\hat\theta` of a constant :math:`\theta` is driven by an error s, through a gradient:

.. math::

    \dot{\hat\theta} = -\Gamma\, \Phi(\mathrm{beyond}(s, \mathrm{dead\_zone}))
                       - (\mathrm{leak} + \mathrm{error\_leak}\, |s|) (\hat\theta - \theta_0)

:math:`\Phi` is linear, :math:`\theta_0` where the estimate starts. With all three left out it is the gradient law.

============== =======================================================================================================
parameter      what it does
============== =======================================================================================================
leak           sigma modification: pulls the estimate back to its start, so that it cannot drift away
error_leak     e modification: the same, in proportion to the error: no pull once the error has gone
dead_zone      a width v, :math:`\mathrm{beyond}(s, v) = s - \mathrm{clip}(s, v)`: no adaptation where the error is
               within the noise
============== =======================================================================================================

With :math:`S = \tfrac12 |\tilde\theta|^2_Q`, :math:`\tilde\theta = \hat\theta - \theta`, and
:math:`\tilde\theta^\top Q \Gamma\, \Phi(s) = s^\top b` (b is what the error of the estimate does to the loop):

.. math::

    \dot S = -s^\top b + \mathrm{clip}(s, \mathrm{dead\_zone})^\top b
             - \tfrac12 (\mathrm{leak} + \mathrm{error\_leak}\, |s|)
             (|\tilde\theta|^2_Q + |\hat\theta - \theta_0|^2_Q - |\theta - \theta_0|^2_Q)

so a leak dissipates two squares and leaves one that is constant, :math:`\tfrac12 \mathrm{leak}\, |\theta -
\theta_0|^2_Q`: zero if the start was right. A dead zone leaves a term of either sign, at most the sum of its elements
times :math:`|b_i|`. The literature's sigma is :math:`\Gamma^{-1} \mathrm{leak}`: as a rate, a leak has one unit for
all estimates.

Where a prediction error :math:`e = W \tilde\theta` can be computed, of this estimate's error alone, a block may fit it
too (`Fit`):

.. math::

    \dot{\hat\theta} = -P\, (\Phi(\mathrm{beyond}(s, \mathrm{dead\_zone})) + W^\top R\, e), \quad
    P = (\Gamma^{-1} + G)^{-1}, \quad \dot G = -\mathrm{forgetting}\, G + W^\top R\, W, \quad G(0) = 0

============== =======================================================================================================
parameter      what it does
============== =======================================================================================================
R              composite: adapts by the prediction error too; without forgetting P = Gamma
forgetting     bounded-gain forgetting: least squares over the last 1/forgetting seconds: each direction of theta
               converges at about the rate of forgetting while W excites it, and has the gain Gamma where nothing is
               known
============== =======================================================================================================

P is at most :math:`\Gamma`, the bound of the gain. With :math:`c P^{-1}` as the weight of V, c a constant,

.. math::

    \tfrac{d}{dt} \tfrac12 |\tilde\theta|^2_{c P^{-1}} = -c\, \tilde\theta^\top
        \Phi(\mathrm{beyond}(s, \mathrm{dead\_zone})) - \tfrac c2 |e|^2_R
        - \tfrac c2 \mathrm{forgetting}\, |\tilde\theta|^2_G

and without forgetting :math:`-c |e|^2_R`. Of a single estimate this is :math:`\dot P^{-1} = -\lambda P^{-1} +
W^\top R W`, the book's law, with its :math:`\lambda = \mathrm{forgetting}\, (1 - P/\Gamma)` [SlotineLi1991]_. Of more,
theirs scales all directions of P by the norm of P; this one bounds each by itself, and is rational.

References
----------
[IoannouSun1996]_ chapter 8; [NarendraAnnaswamy1987]_ for the e modification; [SlotineLi1991]_ section 8.7 for
composite adaptation and bounded-gain forgetting.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

from dmframe.certificate import (
    SX,
    Bounded,
    Clipped,
    Dissipated,
    Gathered,
    NormSquare,
    Square,
    Stored,
    beyond,
    gathered,
    norm,
)
from dmframe.linalg import metric, solve_spd, square, times
from dmframe.naming import named


@final
@dataclass(frozen=True)
class Terms:
    """What an adaptation adds to its block's certificate."""

    dissipation: tuple[Dissipated, ...] = ()
    excess: tuple[Bounded, ...] = ()
    storage: tuple[Stored, ...] = ()

    def __add__(self, other: Terms) -> Terms:
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Terms(*(mine + theirs for mine, theirs in pairs))


@final
@dataclass(frozen=True)
class Estimate:
    """One estimate with what its certificate needs.

    Parameters
    ----------
    value, truth, nominal
        The estimate, what it estimates, and where it starts.
    weight
        Q: S is half of |value - truth|_Q^2; a matrix, or a column for a diagonal.
    """

    value: SX
    truth: SX
    nominal: SX
    weight: SX

    @property
    def error(self) -> SX:
        """The estimate minus the truth."""
        return self.value - self.truth

    @property
    def storage(self) -> Square:
        """|estimate - truth|^2_Q; S is half of it."""
        return Square(self.error, self.weight)


@final
@dataclass(frozen=True)
class Adaptation:
    """The law that a block's parameters choose; None where they do not."""

    leak: SX | None
    error_leak: SX | None
    width: SX | None

    @property
    def plain(self) -> bool:
        """True for the gradient law."""
        return self.leak is None and self.error_leak is None and self.width is None

    def drive(self, error: SX) -> SX:
        """What the gradient takes for the error: what it has beyond the dead zone."""
        return error if self.width is None else beyond(error, self.width)

    def rate(self, gradient: SX, value: SX, nominal: SX, error: SX) -> SX:
        r"""The rate of an estimate.

        Parameters
        ----------
        gradient
            :math:`-\Gamma \Phi(\mathrm{beyond}(s, \mathrm{dead\_zone}))`, of `drive`.
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

    def terms(self, estimates: Sequence[Estimate], error: SX) -> Terms:
        """What the leaks of a block's estimates dissipate, and what they leave."""
        found = Terms()
        for estimate in estimates:
            if self.leak is not None:
                found += _leaked(estimate, self.leak)
            if self.error_leak is not None:
                plain = _leaked(estimate, self.error_leak)
                found += Terms(
                    tuple(_by(term, error) for term in plain.dissipation),
                    tuple(_by(term, error) for term in plain.excess),
                )
        return found

    def idle(self, error: SX, effect: SX) -> Terms:
        """What the dead zone leaves of s'b: b is what the errors of the block's estimates do."""
        if self.width is None:
            return Terms()
        return Terms(excess=(Clipped(error, self.width, effect),))


@final
@dataclass(frozen=True)
class Fit:
    """A prediction error that an estimate fits beside the error that drives it.

    Parameters
    ----------
    error
        e, a column.
    regressor
        W of e = W (estimate - truth).
    by
        r, the diagonal of R: a column.
    forgetting
        None for composite adaptation without forgetting.
    state
        The state that gathers G, a square matrix; read where there is forgetting.
    """

    error: SX
    regressor: SX
    by: SX
    forgetting: SX | None = None
    state: SX | None = None

    @property
    def gradient(self) -> SX:
        """W' R e."""
        return self.regressor.T @ (self.by * self.error)

    def gained(self, gain: SX, gradient: SX) -> SX:
        """P times a gradient, with Gamma the `gain`: a matrix, or a column for a diagonal."""
        if self.forgetting is None:
            return times(gain, gradient)
        return solve_spd(square(metric(gain)) + self._memory, gradient)

    def rates(self, state: str) -> dict[str, SX]:
        """The rate of G, if there is forgetting, by the state's name."""
        if self.forgetting is None:
            return {}
        return {state: gathered(self._memory, self.regressor, self.by, self.forgetting)}

    def terms(self, estimate: Estimate, c: SX) -> Terms:
        """What V holds more than the estimate's own square, whose weight is c over Gamma, and what the fit spends."""
        if self.forgetting is None:
            return Terms((Square(self.error, c * self.by),))
        spent = Square(self.error, c * self.by / 2), self._gathered(estimate, c * self.forgetting / 2)
        return Terms(spent, storage=(self._gathered(estimate, c),))

    @property
    def _memory(self) -> SX:
        """G: symmetric, whatever the state's symbols are."""
        assert self.state is not None
        return named("G", (self.state + self.state.T) / 2)

    def _gathered(self, estimate: Estimate, weight: SX) -> Gathered:
        return Gathered(estimate.error, weight, self._memory, self.regressor, self.by, self.forgetting)


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
            Square(estimate.error, half),
            Square(estimate.value - estimate.nominal, half),
        ),
        (Square(away, half),),
    )


def _by(term: Dissipated | Bounded, error: SX) -> NormSquare:
    assert isinstance(term, Square)
    return NormSquare(term.vector, term.weight, error)


__all__ = ["Adaptation", "Estimate", "Fit", "Terms", "adaptation"]
