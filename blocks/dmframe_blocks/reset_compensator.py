"""Gradient adaptation of dynamic parameters with a reset of the load's parameters at each change of load."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, final

import casadi as ca

from dmframe.block import (
    SX,
    Adapted,
    AdaptingBlock,
    Certificate,
    Diagonal,
    Equations,
    Input,
    NonNegative,
    Output,
    Positive,
    Real,
    Scalar,
    Signals,
    Square,
    TrueValue,
    named,
    operation,
)

TEN = 10  # parameters of a load, which come first


@final
class ResetCompensator(AdaptingBlock):
    r"""Adaptive dynamic compensation that resets the load's parameters when a signal indicates a new load.

    A continuous state cannot jump. There are therefore two sets of estimates of the load, one in use and one idle,
    which are exchanged when `odd` changes. For the first ten parameters :math:`c_{odd}` and :math:`s_{odd}` are the
    cosine and the sine of a quarter turn times `odd`, that is 1 and 0 or 0 and 1; for all others 1 and 0.
    :math:`a_{before}` is the prior plus the expected load, and :math:`\lambda = \mathrm{clearing}`. With products
    element by element:

    .. math::

        \hat a_d &= a_{before} + c_{odd}\, a_{even} + s_{odd}\, a_{odd}, \quad
            \tau_{dc} = Y_d \hat a_d + \tau_{known} + \tau_{task}   \tag{1} \\
        \mathrm{idle} &= c_{odd}\, a_{odd} - s_{odd}\, a_{even}   \tag{2} \\
        \dot a_{even} &= -\Gamma c_{odd}\, (Y_d^\top \sigma) + \lambda s_{odd}\, \mathrm{idle}   \tag{3} \\
        \dot a_{odd} &= -\Gamma s_{odd}\, (Y_d^\top \sigma) - \lambda c_{odd}\, \mathrm{idle}   \tag{4}

    The estimate in use follows the gradient law. The idle set decays, so that it starts near the prior when it is used
    next. With :math:`\tilde a_d = \hat a_d - a_d`, and since the squares of cosine and sine add up to 1 for any `odd`,

    .. math::

        S &= \tfrac12 |\tilde a_d|^2_{\Gamma^{-1}} + \tfrac12 |\mathrm{idle}|^2_{\Gamma^{-1}}   \tag{5} \\
        \dot S &= -\sigma^\top Y_d \tilde a_d - \lambda |\mathrm{idle}|^2_{\Gamma^{-1}}   \tag{6}

    When `odd` changes, the two sets are exchanged in S. If the idle set has decayed, half of :math:`|\tilde a_d|^2 +
    |\mathrm{idle}|^2` of the load's parameters becomes the sum for the prior's error and for the previous estimate.

    Parameters
    ----------
    Gamma : diagonal (p,), > 0
        Adaptation gain.
    a_d_hat : (p,)
        Initial estimate, and the estimate of the load after each reset, to which the expected load is added; by default
        zero.
    clearing : scalar, 1/s, >= 0
        Decay rate of the idle set. With 0 it is kept, so that the estimate of a load is available again if every other
        load is the same, such as the empty gripper.

    Notes
    -----
    clearing times the sampling period has to stay below one. Not for: loads that change within less than about
    3/clearing.

    References
    ----------
    [WangTAC2020]_ eqs. (12), (15), Remark 6.
    """

    inputs = (
        Input("Y_d", "n p", "N m"),
        Input("sigma", "n", "rad/s"),
        Input("odd"),
        Input("a_expected", "10", optional=True),
        Input("tau_task", "n", "N m", optional=True),
        Input("tau_known", "n", "N m", optional=True),
    )
    outputs = (Output("tau_dc", "n", "N m"), Output("a_d_hat", "p", ""))
    estimates = (
        Adapted("a_even", "p", gain="Gamma"),
        Adapted("a_odd", "p", gain="Gamma"),
    )
    truth = (Input("a_d", "p", ""),)
    driven_by: ClassVar[str] = "sigma"

    Gamma: Diagonal = Positive("p")
    a_d_hat: Diagonal | None = Real("p", default=None)
    clearing: Scalar = NonNegative("", "1/s", default=2.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        c, s = self._chosen(u, p)
        a_d_hat = self._before(u, p) + c * x.a_even + s * x.a_odd
        return Equations({"tau_dc": u.Y_d @ a_d_hat + u.tau_known + u.tau_task, "a_d_hat": a_d_hat})

    def direction(self, u: Signals, x: Signals, p: Signals, sigma: SX) -> Mapping[str, SX]:
        """(3) and (4), but for the gain."""
        (c, s), downhill = self._chosen(u, p), -u.Y_d.T @ sigma
        fading = p.clearing * self._idle(u, x, p) / p.Gamma
        return {"a_even": c * downhill + s * fading, "a_odd": s * downhill - c * fading}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(5) and (6)."""
        c, s = self._chosen(u, p)
        unknown = truth.a_d - self._before(u, p)
        a_d_err = c * x.a_even + s * x.a_odd - unknown
        return Certificate(
            estimates={"a_even": TrueValue(c * unknown), "a_odd": TrueValue(s * unknown)},
            dissipation=(Square(self._idle(u, x, p), p.clearing / p.Gamma),),
            supply=-ca.dot(u.sigma, u.Y_d @ a_d_err),
        )

    def _chosen(self, u: Signals, p: Signals) -> tuple[SX, SX]:
        return named("c_odd", cosines(u.odd, p.Gamma)), named("s_odd", sines(u.odd, p.Gamma))

    def _before(self, u: Signals, p: Signals) -> SX:
        """The prior plus the expected load."""
        prior = p.a_d_hat if "a_d_hat" in p else ca.SX.zeros(p.Gamma.shape)
        return named("a_before", before(u.a_expected, prior))

    def _idle(self, u: Signals, x: Signals, p: Signals) -> SX:
        """(2)."""
        c, s = self._chosen(u, p)
        return named("idle", c * x.a_odd - s * x.a_even)


@operation
def cosines(odd: Any, every: Any) -> Any:
    """Cosine of a quarter turn times `odd` for the parameters of a load, 1 for all others."""
    return ca.vertcat(ca.repmat(ca.cos(ca.pi / 2 * odd), TEN, 1), ca.SX.ones(every.shape[0] - TEN))


@operation
def sines(odd: Any, every: Any) -> Any:
    """Sine of a quarter turn times `odd` for the parameters of a load, 0 for all others."""
    return ca.vertcat(ca.repmat(ca.sin(ca.pi / 2 * odd), TEN, 1), ca.SX.zeros(every.shape[0] - TEN))


@operation
def before(a_expected: Any, prior: Any) -> Any:
    """The prior, with the expected load added to its first ten elements."""
    return prior + ca.vertcat(a_expected, ca.SX.zeros(prior.shape[0] - TEN))
