"""Adaptive realisation of a torque through a PID position servo."""

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
    CommonLyapunov,
    Condition,
    Diagonal,
    Equations,
    Input,
    Output,
    Positive,
    Real,
    Signals,
    StableLinear,
    State,
    TrueValue,
    Written,
    named,
    sentence,
)


@final
class PidTorqueInverse(AdaptingBlock):
    r"""Computes the velocity command of a closed PID servo from a torque.

    With :math:`z = \int (q_c - q)`, products element by element; :math:`\epsilon` drives the adaptation:

    .. math::

        \dot q_c &= \dot q + w_P (q - q_c) - w_I z + w \tau_d    \tag{1} \\
        \dot w   &= -\Lambda\, \tau_d\, \epsilon                 \tag{2} \\
        \dot w_P &= \Lambda_P (q_c - q)\, \epsilon               \tag{3} \\
        \dot w_I &= \Lambda_I z\, \epsilon                       \tag{4}

    Estimates minus true values: :math:`\tilde w = w - 1/K_\star`, :math:`\tilde w_P = w_P - K_P/K_D`,
    :math:`\tilde w_I = w_I - K_I/K_D`, with :math:`K_\star = K K_D`. The initial value of the servo's integrator is
    arbitrary; its constant offset i + z acts as the torque :math:`-K K_I (i + z)`, for which the regressor has the bias
    column.

    .. math::

        S &= \tfrac12 |w - 1/K_\star|^2_{K_\star/\Lambda} + \tfrac12 |w_P - K_P/K_D|^2_{K_\star/\Lambda_P}
             + \tfrac12 |w_I - K_I/K_D|^2_{K_\star/\Lambda_I}                                                \tag{5} \\
        \dot S &= -\epsilon^\top K_\star (\tilde w \tau_d + \tilde w_P (q - q_c) - \tilde w_I z)             \tag{6}

    Parameters
    ----------
    Lambda, Lambda_P, Lambda_I : diagonal (n,), > 0
        Adaptation gains of :math:`w`, :math:`w_P` and :math:`w_I`.
    w, w_P, w_I : (n,), rad/(N m s), 1/s, 1/s^2
        Initial estimates.

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
        Input("epsilon", "n", "*"),
    )
    outputs = (Output("dq_c", "n", "rad/s", Access.COMMANDED),)
    states = (State("z", "n", "rad s"),)
    estimates = (
        Adapted("w", "n", "rad/(N m s)", gain="Lambda"),
        Adapted("w_P", "n", "1/s", gain="Lambda_P"),
        Adapted("w_I", "n", "1/s^2", gain="Lambda_I"),
    )
    driven_by: ClassVar[str] = "epsilon"
    truth = (
        Input("K", "n", "N m/V"),
        Input("K_D", "n", "V s/rad"),
        Input("K_P", "n", "V/rad"),
        Input("K_I", "n", "V/(rad s)"),
        Input("i", "n", "rad s"),
    )

    Lambda: Diagonal = Positive("n")
    Lambda_P: Diagonal = Positive("n")
    Lambda_I: Diagonal = Positive("n")
    w: Diagonal = Real("n", "rad/(N m s)", default=0.0)
    w_P: Diagonal = Real("n", "1/s", default=0.0)
    w_I: Diagonal = Real("n", "1/s^2", default=0.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(
            outputs={"dq_c": u.dq + x.w_P * (u.q - u.q_c) - x.w_I * x.z + x.w * u.tau_d},
            rates={"z": u.q_c - u.q},
        )

    def direction(self, u: Signals, x: Signals, p: Signals, epsilon: SX) -> Mapping[str, SX]:
        """(2) to (4), but for the gains."""
        return {"w": -u.tau_d * epsilon, "w_P": (u.q_c - u.q) * epsilon, "w_I": x.z * epsilon}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(5) and (6)."""
        K_star = named("K_star", truth.K * truth.K_D)
        w, w_P, w_I = (TrueValue(value, K_star) for value in (1 / K_star, truth.K_P / truth.K_D, truth.K_I / truth.K_D))
        off = (x.w_P - w_P.value) * (u.q - u.q_c) - (x.w_I - w_I.value) * x.z
        return Certificate(
            estimates={"w": w, "w_P": w_P, "w_I": w_I},
            supply=-ca.dot(u.epsilon, K_star * ((x.w - w.value) * u.tau_d + off)),
            linear=(
                StableLinear((x.z, u.q_c - u.q), ((0, 1), (-x.w_I, -x.w_P)), (x.z, u.q_c - u.q), self._otherwise(p)),
            ),
            truth={"tau_bias": truth.K * truth.K_I * (truth.i + x.z)},
        )

    def _otherwise(self, p: Signals) -> tuple[Condition, ...]:
        """The error q - q_c in (1) is stable if w_P and w_I move in suitable boxes."""
        equation = Written("z'' + w_P z' + w_I z = 0", "z̈ + w_P ż + w_I z = 0", r"\ddot z + w_P \dot z + w_I z = 0")
        moving = sentence("{equation} stays exponentially stable", equation=equation)
        if "w_P_box" in p and "w_I_box" in p:
            return (CommonLyapunov(moving, p.w_P_box, p.w_I_box, "eq. (43)"),)
        text = sentence("{moving} (give w_P_box and w_I_box to have it checked)", moving=moving)
        return (Assumption(text, "eq. (43)"),)
