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

    With `K_c` the position error is fed back to the reference position: :math:`q_{tie}` with
    :math:`\dot q_{tie} = \dot q_r + K_c (q - q_{tie})` replaces :math:`q_r` everywhere, and :math:`q - q_{tie}`, whose
    rate is :math:`\sigma - K_c (q - q_{tie})`, replaces e. :math:`\dot S` then contains the further terms
    :math:`-|q - q_{tie}|^2_{K_c K K_I} - \sigma^\top \tau_{bias}`: a disturbance does not accumulate in the position
    error. The constant torque :math:`\tau_{bias}` is the initial value of the integrator,
    :math:`K K_I (i + q_c - q)`, for which the regressor has the bias column. If :math:`K_c` is the decay rate of
    `joint_tracking`, and the robot starts on its path, :math:`q - q_{tie}` is the tracking error.

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
    K_c : diagonal (n,), 1/s, > 0
        Gain of the position feedback to the reference position; by default there is none. It requires ``bias: true`` of
        the regressor. With a gain near the decay rate of the tracking error the bounds of `verify` are smallest.

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
    states = (State("q_r", "n", "rad", optional=True), State("q_tie", "n", "rad", optional=True))
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
    K_c: Diagonal | None = Positive("n", "1/s", default=None)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        name, q_r = self._reference(x, p)
        return Equations(
            outputs={
                "dq_c": u.dq_r + x.w_I * q_r + x.w * u.tau_dc - x.w_I * u.q_c,
                "dq_ref": u.dq_r,
                "sigma": u.dq - u.dq_r,
                "w": x.w,
                "w_I": x.w_I,
            },
            rates={name: u.dq_r + p.K_c * (u.q - q_r) if "K_c" in p else u.dq_r},
        )

    def direction(self, u: Signals, x: Signals, p: Signals, sigma: SX) -> Mapping[str, SX]:
        """(2) and (3), but for the gains."""
        _, q_r = self._reference(x, p)
        return {
            "w": -(u.tau_dc * sigma + u.tau_f * u.e_f),
            "w_I": (u.q_c - q_r) * sigma - u.q_f * u.e_f,
        }

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """The reference position starts at the measured pose."""
        return {"q_tie" if "K_c" in p else "q_r": u.q}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(4) and (5), and the stable linear subsystem of the command."""
        K_star = named("K_star", truth.K * truth.K_P)
        sigma = named("sigma", u.dq - u.dq_r)
        tied, offset, (_, q_r) = "K_c" in p, truth.i + u.q_c - u.q, self._reference(x, p)
        e, h = u.q - q_r if tied else truth.i + u.q_c - q_r, u.q_c - q_r
        stiffness = truth.K * truth.K_I
        w, w_I = TrueValue(1 / K_star, K_star), TrueValue(truth.K_I / truth.K_P, K_star)
        filtered = K_star * ((x.w - w.value) * u.tau_f + (x.w_I - w_I.value) * u.q_f)
        return Certificate(
            storage=(Square(e, stiffness),),
            estimates={"w": w, "w_I": w_I},
            dissipation=(
                Square(sigma, K_star + truth.B),
                *((Square(e, p.K_c * stiffness),) if tied else ()),
            ),
            dominates=(1,),
            disturbed=(1,),
            supply=-ca.dot(sigma, truth.K * truth.u - u.tau_dc - truth.B * sigma)
            - ca.dot(u.e_f, filtered)
            - (ca.dot(sigma, stiffness * offset) if tied else 0),
            linear=(
                StableLinear(
                    vectors=(h - truth.momentum / K_star,),
                    rates=((-truth.K_I / truth.K_P,),),
                    bounded=(h,),
                    otherwise=self._otherwise(p),
                ),
            ),
            truth={"tau_bias": stiffness * offset} if tied else {},
        )

    def _reference(self, x: Signals, p: Signals) -> tuple[str, SX]:
        """The state that is the reference position, and its value."""
        return ("q_tie", x.q_tie) if "K_c" in p else ("q_r", x.q_r)

    def _otherwise(self, p: Signals) -> tuple[Condition, ...]:
        """(1) is stable if w_I stays positive, which a box guarantees."""
        if "w_I_box" in p:
            return (Inequality("w_I_box: lower end > 0", p.w_I_box[:, 0], "Theorem 1, K_I-hat uniformly positive"),)
        text = sentence("{w_I} stays uniformly above zero (give w_I_box to make sure of it)")
        return (Assumption(text, "Theorem 1"),)
