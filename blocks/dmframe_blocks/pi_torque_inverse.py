"""Adaptive realisation of a torque through a PI velocity servo."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

import casadi as ca

from dmframe.block import (
    SX,
    Access,
    Adapted,
    AdaptingBlock,
    Assumption,
    Certificate,
    Condition,
    Diagonal,
    Equations,
    Inequality,
    Input,
    Output,
    Positive,
    Real,
    Signals,
    StableLinear,
    TrueValue,
    named,
    sentence,
)


@final
class PiTorqueInverse(AdaptingBlock):
    r"""Computes the velocity command of a closed PI servo from a torque.

    .. math::

        \dot q_c &= \dot q + w_I (q - q_c) + w \tau_d    \tag{1} \\
        \dot w   &= -\Lambda (\tau_d\, \epsilon + \tau_f e_f)         \tag{2} \\
        \dot w_I &= -\Lambda_I ((q - q_c)\, \epsilon + q_f e_f)       \tag{3}

    products element by element; :math:`\epsilon` drives the adaptation, or :math:`e_f` of a `filtered_regressor`.
    Estimates minus true values: :math:`\tilde w = w - 1/K_\star`, :math:`\tilde w_I = w_I - K_I/K_P`, with
    :math:`K_\star = K K_P`. The initial value of the servo's integrator is arbitrary; its constant offset
    :math:`i - (q - q_c)` acts as the torque :math:`-K K_I (i - q + q_c)`, for which the regressor has the bias column.

    .. math::

        S &= \tfrac12 |w - 1/K_\star|^2_{K_\star/\Lambda} + \tfrac12 |w_I - K_I/K_P|^2_{K_\star/\Lambda_I}   \tag{4} \\
        \dot S &= -\epsilon^\top K_\star (\tilde w \tau_d + \tilde w_I (q - q_c))
                  - e_f^\top K_\star (\tilde w \tau_f + \tilde w_I q_f)                                     \tag{5}

    Parameters
    ----------
    Lambda, Lambda_I : diagonal (n,), > 0
        Adaptation gains of :math:`w` and :math:`w_I`.
    w, w_I : (n,), rad/(N m s), 1/s
        Initial estimates.
    w_box, w_I_box : [lower, upper]
        Intervals onto which the estimates are projected; a positive lower bound of `w_I_box` keeps the command stable.

    Notes
    -----
    :math:`\tau_{bias}` is the constant torque of the offset of the servo's integrator.

    References
    ----------
    [WangTAC2020]_ eqs. (49)-(53).
    """

    inputs = (
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
        Input("q_c", "n", "rad"),
        Input("tau_d", "n", "N m"),
        Input("epsilon", "n", "*", optional=True),
        Input("tau_f", "n", "N m", optional=True),
        Input("q_f", "n", "rad", optional=True),
        Input("e_f", "n", "rad/s", optional=True),
    )
    outputs = (
        Output("dq_c", "n", "rad/s", Access.COMMANDED),
        Output("w", "n", "rad/(N m s)"),
        Output("w_I", "n", "1/s"),
    )
    estimates = (
        Adapted("w", "n", "rad/(N m s)", gain="Lambda"),
        Adapted("w_I", "n", "1/s", gain="Lambda_I"),
    )
    driven_by: ClassVar[str] = "epsilon"
    truth = (
        Input("K", "n", "N m/V"),
        Input("K_P", "n", "V s/rad"),
        Input("K_I", "n", "V/rad"),
        Input("i", "n", "rad"),
    )

    Lambda: Diagonal = Positive("n")
    Lambda_I: Diagonal = Positive("n")
    w: Diagonal = Real("n", "rad/(N m s)", default=0.0)
    w_I: Diagonal = Real("n", "1/s", default=0.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(
            outputs={"dq_c": u.dq + x.w_I * (u.q - u.q_c) + x.w * u.tau_d, "w": x.w, "w_I": x.w_I},
        )

    def direction(self, u: Signals, x: Signals, p: Signals, epsilon: SX) -> Mapping[str, SX]:
        """(2) and (3), but for the gains."""
        return {
            "w": -(u.tau_d * epsilon + u.tau_f * u.e_f),
            "w_I": -((u.q - u.q_c) * epsilon + u.q_f * u.e_f),
        }

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(4) and (5)."""
        K_star = named("K_star", truth.K * truth.K_P)
        w, w_I = TrueValue(1 / K_star, K_star), TrueValue(truth.K_I / truth.K_P, K_star)
        w_err, w_I_err = x.w - w.value, x.w_I - w_I.value
        effect = K_star * (w_err * u.tau_d + w_I_err * (u.q - u.q_c))
        filtered = K_star * (w_err * u.tau_f + w_I_err * u.q_f)
        return Certificate(
            estimates={"w": w, "w_I": w_I},
            supply=-ca.dot(u.epsilon, effect) - ca.dot(u.e_f, filtered),
            linear=(StableLinear((u.q_c - u.q,), ((-x.w_I,),), (u.q_c - u.q,), self._otherwise(p)),),
            truth={"tau_bias": truth.K * truth.K_I * (truth.i - u.q + u.q_c)},
        )

    def _otherwise(self, p: Signals) -> tuple[Condition, ...]:
        """The error q - q_c in (1) is stable if w_I stays positive, which a box guarantees."""
        if "w_I_box" in p:
            return (Inequality("w_I_box: lower end > 0", p.w_I_box[:, 0], "Section IV, K_I-hat uniformly positive"),)
        text = sentence("{w_I} stays uniformly above zero (give w_I_box to make sure of it)")
        return (Assumption(text, "Section IV"),)
