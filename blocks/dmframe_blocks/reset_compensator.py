"""Gradient adaptation of dynamic parameters whose load's part starts again whenever another load is there."""

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

TEN = 10  # parameters of a load, which stand in front


@final
class ResetCompensator(AdaptingBlock):
    r"""Compensates the dynamics, and begins anew with the load's parameters when it is told of another one.

    A state in continuous time does not jump. So there are two sets of estimates of the load, one in use and one idle,
    which change places when `odd` does. With :math:`c_{odd}` and :math:`s_{odd}` the cosine and the sine of a quarter
    turn times `odd`, that is 1 and 0 or 0 and 1, for the ten first parameters, and 1 and 0 for all others; with
    :math:`a_{before}` the prior and what is expected of a load; with :math:`\lambda = \mathrm{clearing}`; and products
    element by element:

    .. math::

        \hat a_d &= a_{before} + c_{odd}\, a_{even} + s_{odd}\, a_{odd}, \quad
            \tau_{dc} = Y_d \hat a_d + \tau_{known} + \tau_{task}   \tag{1} \\
        \mathrm{idle} &= c_{odd}\, a_{odd} - s_{odd}\, a_{even}   \tag{2} \\
        \dot a_{even} &= -\Gamma c_{odd}\, (Y_d^\top \sigma) + \lambda s_{odd}\, \mathrm{idle}   \tag{3} \\
        \dot a_{odd} &= -\Gamma s_{odd}\, (Y_d^\top \sigma) - \lambda c_{odd}\, \mathrm{idle}   \tag{4}

    The estimate moves by the plain gradient, and what is idle fades: when its turn comes, some time after, it begins at
    the prior. With :math:`\tilde a_d = \hat a_d - a_d`, and because their squares make 1 whatever `odd` is,

    .. math::

        S &= \tfrac12 |\tilde a_d|^2_{\Gamma^{-1}} + \tfrac12 |\mathrm{idle}|^2_{\Gamma^{-1}}   \tag{5} \\
        \dot S &= -\sigma^\top Y_d \tilde a_d - \lambda |\mathrm{idle}|^2_{\Gamma^{-1}}   \tag{6}

    Where `odd` steps, the two sets change places in S: of a load's parameters, half of :math:`|\tilde a_d|^2 +
    |\mathrm{idle}|^2` before becomes that of the prior's error and of all that had been learnt, if the idle set had
    faded.

    Parameters
    ----------
    Gamma : diagonal (p,), > 0
        Adaptation gain.
    a_d_hat : (p,)
        The estimate at the start, and that of the load after each reset, beside what is expected of it; zero if left
        out.
    clearing : scalar, 1/s, >= 0
        Rate at which the idle set fades. At 0 it is kept, and what was learnt of a load is there again when every other
        one is the same, such as the empty gripper.

    Notes
    -----
    Of Gamma T and clearing T, T being the sampling period, the latter has to stay below one. Not for: two loads in a
    shorter time than some 3/clearing.

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
        """What is held for true before anything is learnt."""
        prior = p.a_d_hat if "a_d_hat" in p else ca.SX.zeros(p.Gamma.shape)
        return named("a_before", before(u.a_expected, prior))

    def _idle(self, u: Signals, x: Signals, p: Signals) -> SX:
        """(2)."""
        c, s = self._chosen(u, p)
        return named("idle", c * x.a_odd - s * x.a_even)


@operation
def cosines(odd: Any, every: Any) -> Any:
    """Of a quarter turn times `odd` for what a load has, 1 for all else."""
    return ca.vertcat(ca.repmat(ca.cos(ca.pi / 2 * odd), TEN, 1), ca.SX.ones(every.shape[0] - TEN))


@operation
def sines(odd: Any, every: Any) -> Any:
    """Of a quarter turn times `odd` for what a load has, 0 for all else."""
    return ca.vertcat(ca.repmat(ca.sin(ca.pi / 2 * odd), TEN, 1), ca.SX.zeros(every.shape[0] - TEN))


@operation
def before(a_expected: Any, prior: Any) -> Any:
    """The prior, and to its first ten what is expected."""
    return prior + ca.vertcat(a_expected, ca.SX.zeros(prior.shape[0] - TEN))
