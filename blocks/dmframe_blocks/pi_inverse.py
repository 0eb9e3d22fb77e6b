"""Adaptive inverse of a PI velocity servo."""

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
    Square,
    StableLinear,
    State,
    TrueValue,
    named,
    sentence,
)


@final
class PiInverse(AdaptingBlock):
    r"""Computes the velocity command of a closed PI servo from a reference velocity and a torque.

    .. math::

        \dot q_c &= \dot q_r + w_I q_r + w \tau_{dc} - w_I q_c, \quad
                    \dot q_{ref} = \dot q_r, \quad \sigma = \dot q - \dot q_{ref}             \tag{1} \\
        \dot w   &= -\Lambda (\tau_{dc} \sigma + \tau_f e_f)                                        \tag{2} \\
        \dot w_I &= \Lambda_I ((q_c - q_r) \sigma - q_f e_f)                                       \tag{3}

    products element by element. The terms in :math:`e_f` are those of composite adaptation with a `filtered_regressor`,
    and zero otherwise. :math:`\tilde w = w - 1/K_\star` and :math:`\tilde w_I = w_I - K_I/K_P` are the estimates minus
    their true values, with :math:`K_\star = K K_P`. With the servo's integrator i and
    :math:`e = i + q_c - q_r`, so that :math:`\dot e = \sigma`:

    .. math::

        S &= \tfrac12 |e|^2_{K K_I} + \tfrac12 |w - 1/K_\star|^2_{K_\star/\Lambda}
             + \tfrac12 |w_I - K_I/K_P|^2_{K_\star/\Lambda_I}                                      \tag{4} \\
        \dot S &= -\sigma^\top (K_\star + B) \sigma - \sigma^\top (K u - \tau_{dc} - B \sigma)
                  - e_f^\top K_\star (\tilde w \tau_f + \tilde w_I q_f)                            \tag{5}

    S does not contain the command. With the momentum :math:`M \dot q`, :math:`z_1 = q_c - q_r - M \dot q / K_\star` is
    a stable linear subsystem with the true gains, :math:`\dot z_1 = -(K_I / K_P)\, z_1 + r`. Its input r and the
    momentum are bounded, so :math:`q_c - q_r` is bounded.

    Parameters
    ----------
    Lambda : diagonal (n,), > 0
        Adaptation gain of the scale :math:`w`. A larger gain adapts to the servo faster and passes more velocity noise.
    Lambda_I : diagonal (n,), > 0
        Adaptation gain of the ratio :math:`w_I`.
    w, w_I : (n,), rad/(N m s), 1/s
        Initial estimates.
    w_box, w_I_box : [lower, upper]
        Intervals onto which the estimates are projected; correct intervals do not affect the proof.

    Notes
    -----
    Not for: a PID position servo; see `pid_inverse`.

    References
    ----------
    [WangTAC2020]_ eqs. (12), (14), (16).
    """

    inputs = (
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
        Input("q_c", "n", "rad"),
        Input("dq_r", "n", "rad/s"),
        Input("tau_dc", "n", "N m"),
        Input("tau_f", "n", "N m", optional=True),
        Input("q_f", "n", "rad", optional=True),
        Input("e_f", "n", "rad/s", optional=True),
    )
    outputs = (
        Output("dq_c", "n", "rad/s", Access.COMMANDED),
        Output("dq_ref", "n", "rad/s"),
        Output("sigma", "n", "rad/s"),
        Output("w", "n", "rad/(N m s)"),
        Output("w_I", "n", "1/s"),
    )
    states = (State("q_r", "n", "rad"),)
    estimates = (
        Adapted("w", "n", "rad/(N m s)", gain="Lambda"),
        Adapted("w_I", "n", "1/s", gain="Lambda_I"),
    )
    driven_by: ClassVar[str] = "sigma"
    truth = (
        Input("K", "n", "N m/V"),
        Input("K_P", "n", "V s/rad"),
        Input("K_I", "n", "V/rad"),
        Input("B", "n", "N m s/rad"),
        Input("i", "n", "rad"),
        Input("u", "n", "V"),
        Input("momentum", "n", "N m s"),
    )

    Lambda: Diagonal = Positive("n", "1/(N^2 m^2 s)")
    Lambda_I: Diagonal = Positive("n", "1/(rad^2 s)")
    w: Diagonal = Real("n", "rad/(N m s)", default=0.0)
    w_I: Diagonal = Real("n", "1/s", default=0.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        dq_ref = u.dq_r
        return Equations(
            outputs={
                "dq_c": dq_ref + x.w_I * x.q_r + x.w * u.tau_dc - x.w_I * u.q_c,
                "dq_ref": dq_ref,
                "sigma": u.dq - dq_ref,
                "w": x.w,
                "w_I": x.w_I,
            },
            rates={"q_r": u.dq_r},
        )

    def direction(self, u: Signals, x: Signals, p: Signals, sigma: SX) -> Mapping[str, SX]:
        """(2) and (3), but for the gains."""
        return {
            "w": -(u.tau_dc * sigma + u.tau_f * u.e_f),
            "w_I": (u.q_c - x.q_r) * sigma - u.q_f * u.e_f,
        }

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """The reference position starts at the measured pose."""
        return {"q_r": u.q}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(4) and (5), and the stable linear subsystem of the command."""
        K_star = named("K_star", truth.K * truth.K_P)
        sigma = named("sigma", u.dq - u.dq_r)
        e, h = truth.i + u.q_c - x.q_r, u.q_c - x.q_r
        w, w_I = TrueValue(1 / K_star, K_star), TrueValue(truth.K_I / truth.K_P, K_star)
        filtered = K_star * ((x.w - w.value) * u.tau_f + (x.w_I - w_I.value) * u.q_f)
        return Certificate(
            storage=(Square(e, truth.K * truth.K_I),),
            estimates={"w": w, "w_I": w_I},
            dissipation=(Square(sigma, K_star + truth.B),),
            dominates=(1,),
            disturbed=(1,),
            supply=-ca.dot(sigma, truth.K * truth.u - u.tau_dc - truth.B * sigma) - ca.dot(u.e_f, filtered),
            linear=(
                StableLinear(
                    vectors=(h - truth.momentum / K_star,),
                    rates=((-truth.K_I / truth.K_P,),),
                    bounded=(h,),
                    otherwise=self._otherwise(p),
                ),
            ),
        )

    def _otherwise(self, p: Signals) -> tuple[Condition, ...]:
        """(1) is stable if w_I stays positive, which a box guarantees."""
        if "w_I_box" in p:
            return (Inequality("w_I_box: lower end > 0", p.w_I_box[:, 0], "Theorem 1, K_I-hat uniformly positive"),)
        text = sentence("{w_I} stays uniformly above zero (give w_I_box to make sure of it)")
        return (Assumption(text, "Theorem 1"),)
