r"""Adaptation laws and their terms in dS/dt: gradient, sigma and e modification, dead zone, composite, forgetting.

Each is an option of every `dmframe.block.AdaptingBlock`. An error s drives the estimate :math:`\hat\theta` of a
constant :math:`\theta` through a gradient:

.. math::

    \dot{\hat\theta} = -\Gamma\, \Phi(\mathrm{beyond}(s, \mathrm{dead\_zone}))
                       - (\mathrm{leak} + \mathrm{error\_leak}\, |s|) (\hat\theta - \theta_0)

:math:`\Phi` is linear and :math:`\theta_0` is the initial estimate. Without these three options it is the gradient law.

============== =======================================================================================================
parameter      effect
============== =======================================================================================================
leak           sigma modification: the estimate decays towards its initial value, which prevents parameter drift
error_leak     e modification: the same, proportional to the norm of the error; it vanishes with the error
dead_zone      a width v, :math:`\mathrm{beyond}(s, v) = s - \mathrm{clip}(s, v)`: no adaptation while the error is
               within the noise
============== =======================================================================================================

With :math:`S = \tfrac12 |\tilde\theta|^2_Q`, :math:`\tilde\theta = \hat\theta - \theta`, and
:math:`\tilde\theta^\top Q \Gamma\, \Phi(s) = s^\top b` (b is the effect of the estimation error on the loop):

.. math::

    \dot S = -s^\top b + \mathrm{clip}(s, \mathrm{dead\_zone})^\top b
             - \tfrac12 (\mathrm{leak} + \mathrm{error\_leak}\, |s|)
             (|\tilde\theta|^2_Q + |\hat\theta - \theta_0|^2_Q - |\theta - \theta_0|^2_Q)

A leak dissipates two squares and leaves a constant residual, :math:`\tfrac12 \mathrm{leak}\, |\theta -
\theta_0|^2_Q`, which is zero if the initial estimate is the true value. A dead zone leaves a residual of either sign,
bounded by the sum of its widths times :math:`|b_i|`. The sigma of the literature is :math:`\Gamma^{-1}
\mathrm{leak}`; `leak` is a rate, so its unit is the same for all estimates.

A block that can compute a prediction error :math:`e = W \tilde\theta` of this estimation error alone may use it as a
second driving signal (`Fit`):

.. math::

    \dot{\hat\theta} = -P\, (\Phi(\mathrm{beyond}(s, \mathrm{dead\_zone})) + W^\top R\, e), \quad
    P = (\Gamma^{-1} + G)^{-1}, \quad \dot G = -\mathrm{forgetting}\, G + W^\top R\, W, \quad G(0) = 0

============== =======================================================================================================
parameter      effect
============== =======================================================================================================
R              composite adaptation: the prediction error drives the estimate too; without forgetting P = Gamma
forgetting     bounded-gain forgetting, least squares over about the last 1/forgetting seconds: each direction of theta
               that W excites converges at about the rate of forgetting; a direction without data keeps the gain Gamma
============== =======================================================================================================

:math:`P \le \Gamma`, so the gain is bounded. With the weight :math:`c P^{-1}` in V, c a constant,

.. math::

    \tfrac{d}{dt} \tfrac12 |\tilde\theta|^2_{c P^{-1}} = -c\, \tilde\theta^\top
        \Phi(\mathrm{beyond}(s, \mathrm{dead\_zone})) - \tfrac c2 |e|^2_R
        - \tfrac c2 \mathrm{forgetting}\, |\tilde\theta|^2_G

and without forgetting the fit dissipates :math:`c |e|^2_R`. For a scalar estimate this is :math:`\dot P^{-1} =
-\lambda P^{-1} + W^\top R W`, the law of [SlotineLi1991]_ with its :math:`\lambda = \mathrm{forgetting}\,
(1 - P/\Gamma)`. For several parameters the law of the book scales all directions of P by the norm of P. The law here
bounds each direction separately, and it is rational in the states.

References
----------
[IoannouSun1996]_ chapter 8; [NarendraAnnaswamy1987]_ for the e modification; [SlotineLi1991]_ section 8.7 for
composite adaptation and bounded-gain forgetting.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

from dmframe.block.certificate import (
    SX,
    Bounded,
    Clipped,
    Dissipated,
    InformationSquare,
    NormSquare,
    Square,
    Stored,
    beyond,
    former_fields,
    gathered,
    norm,
)
from dmframe.block.linalg import metric, solve_spd, square, times
from dmframe.block.naming import named


@final
@dataclass(frozen=True)
class Terms:
    """Terms of an adaptation in the certificate of its block."""

    dissipation: tuple[Dissipated, ...] = ()
    residual: tuple[Bounded, ...] = ()
    storage: tuple[Stored, ...] = ()

    def __add__(self, other: Terms) -> Terms:
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Terms(*(mine + theirs for mine, theirs in pairs))


former_fields(Terms)


@final
@dataclass(frozen=True)
class Estimate:
    """One estimate, with the true value, initial value and weight of its storage function.

    Parameters
    ----------
    value, truth, nominal
        The estimate, its true value and its initial value.
    weight
        Q: S is half of |value - truth|_Q^2; a matrix, or a column for a diagonal matrix.
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
    """The adaptation law chosen by a block's parameters; None for each modification that is not used."""

    leak: SX | None
    error_leak: SX | None
    width: SX | None

    @property
    def plain(self) -> bool:
        """True for the gradient law."""
        return self.leak is None and self.error_leak is None and self.width is None

    def drive(self, error: SX) -> SX:
        """The error after the dead zone, which drives the gradient."""
        return error if self.width is None else beyond(error, self.width)

    def rate(self, gradient: SX, value: SX, nominal: SX, error: SX) -> SX:
        r"""The rate of an estimate.

        Parameters
        ----------
        gradient
            :math:`-\Gamma \Phi(\mathrm{beyond}(s, \mathrm{dead\_zone}))`, of `drive`.
        value, nominal
            The estimate and its initial value.
        error
            s.
        """
        if self.leak is not None:
            gradient = gradient - self.leak * (value - nominal)
        if self.error_leak is not None:
            gradient = gradient - self.error_leak * norm(error) * (value - nominal)
        return gradient

    def terms(self, estimates: Sequence[Estimate], error: SX) -> Terms:
        """Dissipation and residual of the leaks of a block's estimates."""
        found = Terms()
        for estimate in estimates:
            if self.leak is not None:
                found += _leaked(estimate, self.leak)
            if self.error_leak is not None:
                plain = _leaked(estimate, self.error_leak)
                found += Terms(
                    tuple(_by(term, error) for term in plain.dissipation),
                    tuple(_by(term, error) for term in plain.residual),
                )
        return found

    def idle(self, error: SX, effect: SX) -> Terms:
        """Residual of the dead zone, clip(s, dead_zone)' b; b is the effect of the block's estimation errors."""
        if self.width is None:
            return Terms()
        return Terms(residual=(Clipped(error, self.width, effect),))


@final
@dataclass(frozen=True)
class Fit:
    """A prediction error that drives an estimate in addition to the tracking error (composite adaptation).

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
        The information matrix G, a square matrix; used with forgetting only.
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
        """P times a gradient; `gain` is Gamma: a matrix, or a column for a diagonal matrix."""
        if self.forgetting is None:
            return times(gain, gradient)
        return solve_spd(square(metric(gain)) + self._memory, gradient)

    def rates(self, state: str) -> dict[str, SX]:
        """The rate of G by the state's name; empty without forgetting."""
        if self.forgetting is None:
            return {}
        return {state: gathered(self._memory, self.regressor, self.by, self.forgetting)}

    def terms(self, estimate: Estimate, c: SX) -> Terms:
        """Dissipation of the fit, and its storage in addition to the square with weight c / Gamma."""
        if self.forgetting is None:
            return Terms((Square(self.error, c * self.by),))
        spent = Square(self.error, c * self.by / 2), self._gathered(estimate, c * self.forgetting / 2)
        return Terms(spent, storage=(self._gathered(estimate, c),))

    @property
    def _memory(self) -> SX:
        """The symmetric part of the state: rounding does not make G asymmetric."""
        assert self.state is not None
        return named("G", (self.state + self.state.T) / 2)

    def _gathered(self, estimate: Estimate, weight: SX) -> InformationSquare:
        return InformationSquare(estimate.error, weight, self._memory, self.regressor, self.by, self.forgetting)


def adaptation(p: Any) -> Adaptation:
    """The adaptation law chosen by the parameters `leak`, `error_leak` and `dead_zone` of a block."""
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
